"""Shape from focus against loops over (3.11) to (3.13), known surfaces, and its own promises."""

import tracemalloc

import numpy as np
import pytest

from microlib import synthetic
from microlib.focus import FocusResult, depth_from_focus, sum_modified_laplacian
from microlib.focus._measures import MEASURES
from tests.scenes import straight_step, tilted_plane

#: µm between frames in most stacks here, and blur per µm so that a step out of focus adds 1 px.
#: All measures that have a name.
NAMES = ("multiscale", *MEASURES)
STEP = 25.0
POSITIONS = STEP * np.arange(11)
SHAPE = (96, 96)


def render(height, positions=POSITIONS, *, seed=0, noise=2.0, texture=None):
    rng = np.random.default_rng(seed)
    if texture is None:
        texture = synthetic.mixed_texture(np.shape(height), rng)
    return synthetic.focal_stack(
        texture, height, positions, blur_rate=1 / STEP, noise=noise, rng=rng
    )


@pytest.fixture(scope="module")
def dome():
    """Heights of a dome well inside the stack, µm, and its frames."""
    height = 75 + synthetic.paraboloid(SHAPE, 100.0)
    return height, render(height)


def rms(error: np.ndarray, border: int = 8) -> float:
    """Root mean square of an error away from the border, in steps."""
    inner = error[border:-border, border:-border] / STEP
    assert np.isfinite(inner).all()
    return float(np.sqrt(np.mean(inner**2)))


def printed_depth(stack: np.ndarray, positions: np.ndarray, window: int) -> np.ndarray:
    """Best frame and (3.13) as it is printed, pixel by pixel; frames of even spacing."""
    measures = [sum_modified_laplacian(frame, window=window).astype(float) for frame in stack]
    spacing = positions[1] - positions[0]
    depth = np.empty(stack.shape[1:])
    for i, j in np.ndindex(depth.shape):
        profile = [measure[i, j] for measure in measures]
        m = profile.index(max(profile))
        if m in (0, len(profile) - 1):
            depth[i, j] = positions[m]
            continue
        below, best, above = np.log(profile[m - 1 : m + 2])
        d_below, d_best, d_above = positions[m - 1 : m + 2]
        numerator = (best - above) * (d_best**2 - d_below**2)
        numerator -= (best - below) * (d_best**2 - d_above**2)
        depth[i, j] = numerator / (2 * spacing * ((best - below) + (best - above)))
    return depth


@pytest.mark.parametrize("window", [3, 5, 9])
def test_depth_by_sml_equals_equation_3_13(dome, window):
    _, stack = dome
    stack = stack[:, :40, :44]
    ours = depth_from_focus(stack, POSITIONS, measure="sml", window=window)
    printed = printed_depth(stack, POSITIONS, window)
    known = np.isfinite(ours.depth)
    assert known.mean() > 0.99
    # float32 depths of up to 250 µm, and logarithms of float32 ratios over curvatures down to 0.01.
    np.testing.assert_allclose(ours.depth[known], printed[known], atol=1e-3)


def test_default_measure_recovers_a_dome(dome):
    height, stack = dome
    result = depth_from_focus(stack, POSITIONS)
    # The limit set for a dome of a sixth of this curvature, at noise of 1 grey level.
    assert rms(result.depth - height) < 0.045
    assert result.depth.dtype == np.float32
    assert not result.at_end.any()
    fit_alone = depth_from_focus(stack, POSITIONS, measure="sml", window=9)
    assert rms(result.depth - height) < 0.6 * rms(fit_alone.depth - height)


def test_depth_step_is_located_to_two_pixels():
    height = 60 + straight_step(SHAPE, 130.0)
    result = depth_from_focus(render(height), POSITIONS)
    wrong = np.abs(result.depth - height) > STEP
    assert not wrong[8:-8, : SHAPE[1] // 2 - 2].any()
    assert not wrong[8:-8, SHAPE[1] // 2 + 2 :].any()
    worst = np.abs(result.depth - height)[8:-8, 8:-8].max(axis=0)
    confidence = np.median(result.confidence, axis=0)
    # Where it is worst, an error of more than a frame is stated.
    assert confidence[8 + worst.argmax()] < 0.5 < 0.9 < confidence[20]
    share = result.uncertainty / STEP
    np.testing.assert_allclose(result.confidence, 1 / (1 + share**2), rtol=1e-4)


def test_all_in_focus_image_is_sharper_than_any_frame(dome):
    _, stack = dome
    texture = synthetic.mixed_texture(SHAPE, np.random.default_rng(0))
    fused = depth_from_focus(stack, POSITIONS).all_in_focus
    assert fused.dtype == stack.dtype
    errors = [np.abs(frame - texture).mean() for frame in stack]
    # The noise of 2 grey levels is in both.
    assert np.abs(fused - texture).mean() < 0.7 * min(errors)


def same(first: FocusResult, second: FocusResult) -> None:
    for field in ("depth", "uncertainty", "confidence", "index", "all_in_focus", "at_end"):
        np.testing.assert_array_equal(getattr(first, field), getattr(second, field), err_msg=field)


@pytest.mark.parametrize("measure", ["multiscale", "sml"])
def test_result_does_not_depend_on_workers_and_kind_of_frames(dome, measure):
    _, stack = dome
    whole = depth_from_focus(stack, POSITIONS, measure=measure)
    for frames in (iter(stack), (frame.copy() for frame in stack), list(stack)):
        same(depth_from_focus(frames, POSITIONS, measure=measure, workers=3), whole)
    same(depth_from_focus(stack, spacing=STEP, measure=measure), whole)
    if measure == "sml":
        same(depth_from_focus(stack, POSITIONS, measure=sum_modified_laplacian), whole)


def test_depth_does_not_depend_on_strips_of_rows(monkeypatch):
    """A strip sees 32 px around it, which is what the measures' windows reach."""
    height = 75 + synthetic.paraboloid((300, 64), 100.0)
    stack = render(height)
    whole = depth_from_focus(stack, POSITIONS)
    monkeypatch.setattr("microlib.focus.multiscale._fits._MAX_ROWS", 64)
    strips = depth_from_focus(stack, POSITIONS)
    np.testing.assert_allclose(strips.depth, whole.depth, atol=1e-4 * STEP)


def test_region_equals_cropped_frames(dome):
    _, stack = dome
    part = depth_from_focus(stack, POSITIONS, region=(8, 20, 60, 40))
    same(part, depth_from_focus(stack[:, 20:60, 8:68], POSITIONS))
    assert part.depth.shape == (40, 60)
    reduced = depth_from_focus(stack, POSITIONS, reduce=2)
    assert reduced.depth.shape == (48, 48)


def test_result_has_a_repr_of_one_line_and_is_compared_by_identity(dome):
    _, stack = dome
    result = depth_from_focus(stack, POSITIONS)
    assert repr(result).startswith("FocusResult(96×96 px, ")
    assert "\n" not in repr(result)
    assert result != depth_from_focus(stack, POSITIONS)
    nothing = depth_from_focus(np.zeros((3, 9, 9), np.uint8), np.arange(3.0))
    assert repr(nothing) == "FocusResult(9×9 px, 0.0 % known)"
    assert nothing.to_dict()["depth_median"] is None


@pytest.mark.parametrize("shape", [(1, 40), (40, 1), (2, 40), (40, 2), (1, 1), (7, 9)])
def test_a_stack_of_a_few_pixels_has_a_result(shape):
    frames = np.random.default_rng(0).integers(0, 255, (9, *shape)).astype(np.uint8)
    result = depth_from_focus(list(frames), np.arange(9.0))
    assert result.depth.shape == result.all_in_focus.shape == shape
    assert (np.isnan(result.uncertainty) == np.isnan(result.depth)).all()


def test_saturated_and_three_frames_have_a_result(dome):
    height, stack = dome
    bright = np.clip(2 * stack.astype(int), 0, 255).astype(np.uint8)
    error = np.abs(depth_from_focus(bright, POSITIONS).depth - height) / STEP
    assert np.nanmedian(error) < 0.1
    flat = render(np.full(SHAPE, 130.0))
    three = depth_from_focus(flat[4:7], POSITIONS[4:7])
    assert rms(three.depth - 130.0) < 0.1


def test_order_of_frames_does_not_matter(dome):
    _, stack = dome
    # The noise that the default measure reckons with is that of the first frame.
    for measure, share in (("multiscale", 0.02), ("sml", 1e-5)):
        up = depth_from_focus(stack, POSITIONS, measure=measure)
        down = depth_from_focus(stack[::-1], POSITIONS[::-1], measure=measure)
        difference = np.abs(up.depth - down.depth) / STEP
        assert np.mean(difference < share) > 0.99  # equal maxima go to the first, another one


def test_depth_is_accurate_at_uneven_positions(dome):
    height, _ = dome
    positions = POSITIONS + STEP * np.array([0, 1, -1, 1, 0, -1, 1, -1, 0, 1, 0]) / 5
    for measure, limit in (("multiscale", 0.06), ("sml", 0.3)):
        result = depth_from_focus(render(height, positions), positions, measure=measure)
        assert rms(result.depth - height) < limit


def test_peaks_at_the_ends_are_flagged():
    height = tilted_plane(SHAPE, 4.0, 0.0) + 125  # from -65 to 315 µm, stack 0 to 250
    beyond = (height < -STEP) | (height > POSITIONS[-1] + STEP)
    # Two frames out of focus there is little left to see: noise decides for the plain measure.
    for measure, noise, share in (("multiscale", 2.0, 0.99), ("sml", 0.5, 0.8)):
        result = depth_from_focus(render(height, noise=noise), POSITIONS, measure=measure)
        assert result.at_end[beyond].mean() > share
        inside = (height > 2 * STEP) & (height < POSITIONS[-1] - 2 * STEP)
        assert result.at_end[inside].mean() < 0.01
        known = np.isfinite(result.depth)
        # Never further out than half a step, whatever the fit says.
        assert result.depth[known].min() >= -STEP / 2 - 1e-3
        assert result.depth[known].max() <= POSITIONS[-1] + STEP / 2 + 1e-3


@pytest.mark.parametrize("measure", NAMES)
@pytest.mark.parametrize(("dtype", "drift"), [("u1", 0), ("u1", 5), ("u2", 5), ("f4", 5)])
def test_depth_is_nan_where_frames_are_uniform(measure, dtype, drift):
    """Nor does a change of light alone."""
    frames = [np.full((40, 44), 77 + drift * k, dtype) for k in range(12)]
    result = depth_from_focus(frames, np.arange(12.0), measure=measure)
    assert np.isnan(result.depth).all()
    assert np.isnan(result.uncertainty).all()
    assert (result.confidence == 0).all()
    assert (result.index == -1).all()


@pytest.mark.parametrize("count", [12, 31, 100])
def test_depth_is_nan_where_frames_show_only_noise(count):
    rng = np.random.default_rng(0)
    noise = np.clip(128 + 3 * rng.standard_normal((count, 96, 96)), 0, 255).astype(np.uint8)
    result = depth_from_focus(noise, np.arange(float(count)))
    assert np.isnan(result.depth).mean() > 0.99
    plain = depth_from_focus(noise, np.arange(float(count)), measure="sml")
    assert np.quantile(plain.confidence, 0.9) < 0.3  # it keeps some depths, and does not trust them


@pytest.mark.parametrize("measure", NAMES)
@pytest.mark.parametrize("count", [3, 7, 12])
def test_repeated_picture_has_no_certain_depth(measure, count):
    """Nor has the noise around it, whatever the picture shows and wherever its best frame is."""
    half = synthetic.mixed_texture((96, 120), np.random.default_rng(0))
    half[:, :60] = 128
    rng = np.random.default_rng(count)
    for noise in (0.0, 1.0, 4.0):
        frames = half + noise * rng.standard_normal((count, *half.shape))
        frames = np.clip(np.rint(frames), 0, 255).astype(np.uint8)
        found = depth_from_focus(frames, np.arange(float(count)), measure=measure)
        # By chance some pixels keep a depth, whose uncertainty says so.
        certain = found.uncertainty < (count - 1) / 5
        assert certain.mean() <= (0 if noise == 0 else 0.01)


def test_half_a_scene_without_texture_gets_no_depth_from_noise():
    texture = synthetic.mixed_texture((96, 160), np.random.default_rng(2))
    texture[:, 60:] = 128
    stack = render(np.full(texture.shape, 125.0), texture=texture, noise=3.0)
    for measure in NAMES:
        depth = depth_from_focus(stack, POSITIONS, measure=measure).depth
        assert np.isfinite(depth[10:-10, 10:50]).mean() > 0.99
        # Blur carries light of the textured half 10 px and more beyond its edge.
        assert np.isfinite(depth[:, 100:]).mean() < 0.01


def test_defocused_light_beside_an_edge_has_no_depth():
    """Out of focus, a bright bar reaches into the dark beside it, which has no texture at all."""
    texture = np.full(SHAPE, 40.0)
    texture[:, 44:52] = 240
    height = np.full(SHAPE, 125.0)
    stack = render(height, texture=texture, noise=1.0)
    best = np.argmax([sum_modified_laplacian(frame, window=9) for frame in stack], axis=0)
    assert np.mean(np.abs(POSITIONS[best] - height) > STEP) > 0.1  # or the test shows nothing
    result = depth_from_focus(stack, POSITIONS)
    known = np.isfinite(result.depth)
    assert known[:, [43, 44, 51, 52]].all()
    # The wide window sees the bar from 26 px away.
    assert known[:, :18].mean() < 0.01
    # 2 % remain, where the bar's light fades into the noise; the plain measure has 63 %.
    assert np.mean(np.abs(result.depth - height)[known] > STEP) * known.mean() < 0.03


def test_depth_is_right_beyond_256_frames():
    positions = np.arange(300.0)
    height = np.full((24, 24), 280.0)
    stack = synthetic.focal_stack(
        synthetic.mixed_texture((24, 24), np.random.default_rng(0)),
        height,
        positions,
        blur_rate=0.05,
    )
    result = depth_from_focus(stack, positions, measure="sml")
    assert np.nanmedian(np.abs(result.depth - 280)) < 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"positions": [0, 1]}, "positions must hold 3 to 65535 values"),
        ({"positions": [0, 2, 1, 3]}, "positions must rise or fall strictly, got 2 followed by 1"),
        ({"positions": [0, 1, 2]}, "frames and positions must be equal in number, got 4 and 3"),
        ({"positions": np.arange(9)}, "frames and positions must be equal in number, got 4 and 9"),
        ({"frames": []}, "frames must hold at least three frames, got none"),
        ({"frames": np.full((4, 9, 9), np.nan)}, r"frames\[0\] must be finite"),
        (
            {"frames": [np.zeros((9, 9)), np.zeros((9, 8))] * 2},
            r"frames\[1\] must be float64 of shape",
        ),
        ({"measure": "sharpness"}, f"measure must be one of {', '.join(NAMES)}, got 'sharpness'"),
        ({"measure": lambda frame: frame[1:]}, r"measure\(frame\) must have shape"),
        ({"measure": lambda frame: frame - 1.0}, r"measure\(frame\) must be zero or positive"),
        ({"measure": lambda frame: frame * np.nan}, r"measure\(frame\) must be finite"),
        ({"window": 5}, "window must not be given with measure 'multiscale', got 5"),
        ({"measure": np.abs, "window": 5}, "window must not be given with measure a function"),
        ({"positions": np.arange(65536.0)}, "positions must hold 3 to 65535 values, got 65536"),
        ({"positions": None}, "positions or spacing must be given, got None"),
        ({"spacing": 1.0}, "positions and spacing must not both be given"),
        ({"positions": None, "spacing": 0}, "positions must rise or fall strictly"),
        ({"region": (0, 0, 20, 4)}, "region must lie in the image of"),
        ({"reduce": 10}, "reduce must be at most 9, the smaller side, got 10"),
        ({"frames": (f for f in np.zeros((3, 9, 9)))}, "must be equal in number, got 3 and 4"),
        (
            {"frames": (f for f in np.zeros((6, 9, 9)))},
            "must be equal in number, got more than 4 and 4",
        ),
        ({"frames": (f for f in np.zeros((0, 9, 9)))}, "frames must hold"),
    ],
)
def test_contradictory_input_is_rejected_by_name(change, words):
    arguments = {"frames": np.zeros((4, 9, 9), np.uint8), "positions": np.arange(4.0), **change}
    with pytest.raises(ValueError, match=words):
        depth_from_focus(**arguments)


def test_exception_of_progress_ends_the_computation(dome):
    for last in (3, len(POSITIONS) + 1):
        told = []

        def stop(done, count, last=last, told=told):
            told.append(done)
            if done >= last:
                raise InterruptedError

        with pytest.raises(InterruptedError):
            depth_from_focus(dome[1], POSITIONS, progress=stop, workers=2)
        assert (np.array(told[:-1]) < last).all()


def test_memory_does_not_grow_with_the_frames():
    stack = np.random.default_rng(0).integers(0, 256, (64, 512, 256)).astype(np.uint8)
    peaks = []
    for count in (16, 64):
        tracemalloc.start()
        depth_from_focus(stack[:count], np.arange(float(count)))
        peaks.append(tracemalloc.get_traced_memory()[1] / stack[0].size)
        tracemalloc.stop()
    # Bytes a pixel; the squares that are looked at first are as many for larger images.
    assert peaks[1] < min(1.25 * peaks[0], 180)


def test_ground_in_focus_in_the_first_frame_has_depth():
    """Section 3.1.2 starts with the background in focus: no earlier frame is there to compare."""
    height = synthetic.parabolic_cylinder(SHAPE, 200.0, width=60.0)
    result = depth_from_focus(render(height), POSITIONS)
    ground = height == 0
    ground[:, 10:-10] = False
    assert np.isfinite(result.depth).all()
    assert np.abs(result.depth[ground]).mean() < 0.05 * STEP
    assert result.at_end[ground].all()


@pytest.mark.parametrize("color", [False, True])
@pytest.mark.parametrize("register", [False, True])
def test_progress_rises_to_twice_the_number_of_frames(color, register):
    count = 9
    texture = synthetic.mixed_texture((40, 44), 0)
    height = 4.0 + tilted_plane((40, 44), 0.05, 0.02)
    frames = synthetic.focal_stack(texture, height, np.arange(float(count)), blur_rate=1.0)
    if color:
        frames = np.repeat(frames[..., None], 3, axis=3)
    told = []
    depth_from_focus(
        frames,
        np.arange(float(count)),
        register=register,
        progress=lambda *done: told.append(done),
    )
    assert [done for done, _ in told] == sorted(done for done, _ in told)
    assert {total for _, total in told} == {2 * count}
    assert told[:count] == [(k + 1, 2 * count) for k in range(count)]  # one for each that is read
    assert told[-1] == (2 * count, 2 * count)
