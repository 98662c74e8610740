"""Shape from focus against loops over (3.11) to (3.13), known surfaces, and its own promises."""

import re
import tracemalloc

import numpy as np
import pytest

from microlib import synthetic
from microlib.focus import FocusResult, depth_from_focus, sum_modified_laplacian
from tests.scenes import straight_step, tilted_plane
from tests.scenes.focus import NAMES, inner, rms, stack_of

#: Distance of the frames in most stacks here, µm; a step out of focus adds 1 px of blur.
STEP = 25.0
POSITIONS = STEP * np.arange(11)
SHAPE = (92, 100)


def render(height, positions=POSITIONS, **options):
    return stack_of(height, positions, rate=1 / STEP, **options)


@pytest.fixture(scope="module")
def dome():
    """Heights of a dome well inside the stack, µm, and its frames."""
    height = 75 + synthetic.paraboloid(SHAPE, 100.0)
    return height, render(height)


def printed_depth(stack: np.ndarray, window: int) -> np.ndarray:
    """Best frame and (3.13) as it is printed, at even positions."""
    measures = np.array([sum_modified_laplacian(f, window=window).astype(float) for f in stack])
    best = measures.argmax(axis=0)
    m = np.clip(best, 1, len(stack) - 2)
    below, top, above = np.log(
        [np.take_along_axis(measures, m[None] + k, 0)[0] for k in (-1, 0, 1)]
    )
    d_below, d_top, d_above = (POSITIONS[m + k] for k in (-1, 0, 1))
    numerator = (top - above) * (d_top**2 - d_below**2) - (top - below) * (d_top**2 - d_above**2)
    depth = numerator / (2 * STEP * ((top - below) + (top - above)))
    return np.where(best == m, depth, POSITIONS[best])


@pytest.mark.parametrize("window", [3, 5, 9])
def test_depth_by_sml_equals_equation_3_13(dome, window):
    _, stack = dome
    stack = stack[:, :40, :44]
    ours = depth_from_focus(stack, POSITIONS, measure="sml", window=window)
    printed = printed_depth(stack, window)
    known = np.isfinite(ours.depth)
    assert known.mean() > 0.99
    # float32 depths of up to 250 µm, and logarithms of float32 ratios over curvatures down to 0.01.
    np.testing.assert_allclose(ours.depth[known], printed[known], atol=1e-3)


def test_default_measure_recovers_a_dome(dome):
    height, stack = dome
    result = depth_from_focus(stack, POSITIONS)
    # The limit set for a dome of a sixth of this curvature, at noise of 1 grey level.
    assert rms(inner(result.depth - height)) < 0.045 * STEP
    assert result.depth.dtype == np.float32
    assert not result.at_end.any()
    numbers = r"depth 8\d\.\d+ to 17\d.* µm, uncertainty 0\.\d+ µm"
    assert re.fullmatch(rf"FocusResult\(100×92 px, 100.0 % known, {numbers}\)", repr(result))
    plain = depth_from_focus(stack, POSITIONS, measure="sml", window=9)
    assert result != plain  # by identity
    assert rms(inner(result.depth - height)) < 0.6 * rms(inner(plain.depth - height))


def test_depth_step_is_located_to_three_pixels():
    height = 60 + straight_step(SHAPE, 130.0)
    result = depth_from_focus(render(height), POSITIONS)
    worst = inner(np.abs(result.depth - height)).max(axis=0)
    beside = np.abs(np.arange(8, SHAPE[1] - 8) - (SHAPE[1] - 1) / 2) > 3
    assert worst[beside].max() <= STEP
    confidence = np.median(result.confidence, axis=0)
    # Where it is worst, an error of more than a frame is stated.
    assert confidence[8 + worst.argmax()] < 0.5 < 0.9 < confidence[20]
    share = result.uncertainty / STEP
    np.testing.assert_allclose(result.confidence, 1 / (1 + share**2), rtol=1e-4)


def same(first: FocusResult, second: FocusResult) -> None:
    for field in ("depth", "uncertainty", "confidence", "index", "all_in_focus", "at_end"):
        np.testing.assert_array_equal(getattr(first, field), getattr(second, field), err_msg=field)


@pytest.mark.parametrize("measure", NAMES)
def test_result_does_not_depend_on_workers_and_kind_of_frames(dome, measure):
    _, stack = dome
    whole = depth_from_focus(stack, POSITIONS, measure=measure)
    for frames in (iter(stack), (frame.copy() for frame in stack), list(stack)):
        same(depth_from_focus(frames, POSITIONS, measure=measure, workers=3), whole)
    same(depth_from_focus(stack, spacing=STEP, measure=measure), whole)
    falling = depth_from_focus(stack, -POSITIONS, measure=measure)
    same(depth_from_focus(stack, spacing=-STEP, measure=measure), falling)
    if measure == "sml":
        same(depth_from_focus(stack, POSITIONS, measure=sum_modified_laplacian), whole)


def test_depth_does_not_depend_on_strips_of_rows():
    """300 rows are measured in two strips, 300 columns in one; the seam is at row 256."""
    stack = render(75 + synthetic.paraboloid((300, 64), 100.0))
    strips = depth_from_focus(stack, POSITIONS)
    whole = depth_from_focus(stack.swapaxes(1, 2), POSITIONS)
    # Elsewhere, filters along the other axis first decide otherwise where a rule is at its limit.
    np.testing.assert_allclose(strips.depth[240:272], whole.depth.T[240:272], atol=1e-3 * STEP)


def test_depth_of_a_region_equals_that_of_cropped_frames(dome):
    _, stack = dome
    part = depth_from_focus(stack, POSITIONS, region=(8, 20, 60, 40))
    same(part, depth_from_focus(stack[:, 20:60, 8:68], POSITIONS))
    assert part.depth.shape == (40, 60)


@pytest.mark.parametrize("shape", [(1, 40), (40, 1), (2, 40), (40, 2), (1, 1), (7, 9)])
def test_a_stack_of_a_few_pixels_has_a_result(shape):
    frames = np.random.default_rng(0).integers(0, 255, (9, *shape)).astype(np.uint8)
    result = depth_from_focus(list(frames), np.arange(9.0))
    assert result.depth.shape == result.all_in_focus.shape == shape
    assert (np.isnan(result.uncertainty) == np.isnan(result.depth)).all()


def test_saturated_and_three_frames_have_a_result(dome):
    height, stack = dome
    bright = np.clip(2 * stack.astype(int), 0, 255).astype(np.uint8)
    assert np.nanmedian(np.abs(depth_from_focus(bright, POSITIONS).depth - height)) < 0.1 * STEP
    three = depth_from_focus(render(np.full(SHAPE, 130.0))[4:7], POSITIONS[4:7])
    assert rms(inner(three.depth - 130.0)) < 0.1 * STEP


def test_depth_does_not_depend_on_order_of_frames(dome):
    _, stack = dome
    # The noise that the default measure reckons with is that of the first frame.
    for measure, share in (("multiscale", 0.02), ("sml", 1e-5)):
        up = depth_from_focus(stack, POSITIONS, measure=measure)
        down = depth_from_focus(stack[::-1], POSITIONS[::-1], measure=measure)
        for name in ("depth", "uncertainty"):
            difference = np.abs(getattr(up, name) - getattr(down, name)) / STEP
            assert np.mean(difference < share) > 0.99  # equal maxima go to the first, another one


def test_depth_is_accurate_at_uneven_positions(dome):
    height, _ = dome
    positions = POSITIONS + STEP * np.array([0, 1, -1, 1, 0, -1, 1, -1, 0, 1, 0]) / 5
    for measure, limit in (("multiscale", 0.06), ("sml", 0.3)):
        result = depth_from_focus(render(height, positions), positions, measure=measure)
        assert rms(inner(result.depth - height)) < limit * STEP


@pytest.mark.parametrize("order", [1, -1])
def test_heights_beyond_the_scan_are_flagged_and_as_uncertain_as_a_random_depth(order):
    height = tilted_plane(SHAPE, 3.8, 0.0) + 125  # from -63 to 313 µm, stack 0 to 250
    beyond = (height < -STEP) | (height > POSITIONS[-1] + STEP)
    inside = (height > 2 * STEP) & (height < POSITIONS[-1] - 2 * STEP)
    # Two frames out of focus there is little left to see: noise decides for the plain measure.
    for measure, noise, share in (("multiscale", 2.0, 0.99), ("sml", 0.5, 0.8)):
        frames = render(height, noise=noise)[::order]
        result = depth_from_focus(frames, POSITIONS[::order], measure=measure)
        assert result.at_end[beyond].mean() > share
        assert result.at_end[inside].mean() < 0.01
        known = np.isfinite(result.depth)
        # Never further out than half a step, whatever the fit says.
        assert result.depth[known].min() >= -STEP / 2 - 1e-3
        assert result.depth[known].max() <= POSITIONS[-1] + STEP / 2 + 1e-3
        uncertain = result.uncertainty >= np.float32(POSITIONS[-1] / np.sqrt(12))
        assert uncertain[beyond & known & result.at_end].mean() > 0.98


@pytest.mark.parametrize("measure", NAMES)
@pytest.mark.parametrize("beyond", [4, 12])
@pytest.mark.filterwarnings("ignore:frames change")  # so blurred, they seem to
def test_surface_far_beyond_the_scan_has_no_certain_depth(measure, beyond):
    """Without a look at the depth and at the pixels around, a quarter has at 12 frames."""
    frames = render(np.full(SHAPE, POSITIONS[-1] + beyond * STEP), noise=0.5)
    found = depth_from_focus(frames, POSITIONS, measure=measure)
    certain = found.uncertainty < np.float32(POSITIONS[-1] / np.sqrt(12))
    assert inner(certain).mean() < 0.02


@pytest.mark.parametrize("measure", NAMES)
def test_heights_at_the_last_usable_frame_are_as_uncertain_as_a_random_depth(measure):
    frames = render(np.full(SHAPE, 225.0))
    frames[-1] = 120
    with pytest.warns(UserWarning, match="frames 10 are uniform, .*: left out"):
        result = depth_from_focus(frames, POSITIONS, measure=measure)
    np.testing.assert_allclose(np.nanmedian(result.depth), 225.0)
    least = POSITIONS[-2] / np.sqrt(12)
    assert np.nanmedian(result.uncertainty) == pytest.approx(least, rel=1e-2)


@pytest.mark.parametrize("measure", NAMES)
@pytest.mark.parametrize(("dtype", "drift"), [("u1", 0), ("u1", 5), ("u2", 5), ("f4", 5)])
def test_depth_is_nan_where_frames_are_uniform(measure, dtype, drift):
    """Also where the light changes."""
    frames = [np.full((40, 44), 77 + drift * k, dtype) for k in range(12)]
    result = depth_from_focus(frames, np.arange(12.0), measure=measure)
    assert np.isnan(result.depth).all()
    assert np.isnan(result.uncertainty).all()
    assert (result.confidence == 0).all()
    assert (result.index == -1).all()
    assert repr(result) == "FocusResult(44×40 px, 0.0 % known)"
    assert result.to_dict()["depth_median"] is None


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


def test_depth_is_right_beyond_256_frames():
    stack = stack_of(np.full((24, 28), 280.0), np.arange(300.0), rate=0.05, noise=0.0)
    found = depth_from_focus(stack, spacing="frame", measure="sml")
    assert np.nanmedian(np.abs(found.depth - 280)) < 1
    assert found.unit == "frames"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"positions": [0, 1, 2]}, "frames and positions must be equal in number, got 4 and 3"),
        ({"frames": np.full((4, 9, 9), np.nan)}, r"frames\[0\] must be finite"),
        ({"frames": [np.ones((9, 9)), np.ones((9, 8))] * 2}, r"frames\[1\] must be float64"),
        ({"measure": "sharpness"}, f"measure must be one of {', '.join(NAMES)}, got 'sharpness'"),
        ({"measure": lambda frame: frame[1:]}, r"measure\(frame\) must have shape"),
        (
            {"measure": lambda frame: 0.5 - np.eye(*frame.shape)},
            r"measure\(frame\) must be zero or positive",
        ),
        ({"measure": lambda frame: frame * np.nan}, r"measure\(frame\) must be finite"),
        ({"window": 5}, "window must not be given with measure 'multiscale', got 5"),
        ({"measure": np.abs, "window": 5}, "window must not be given with measure a function"),
        ({"positions": np.arange(65536.0)}, "positions must hold 3 to 65535 values, got 65536"),
        ({"positions": None}, 'positions or spacing must be given, .*; spacing="frame" gives'),
        ({"spacing": 1.0}, "positions and spacing must not both be given"),
        ({"positions": None, "spacing": 0}, "positions must rise or fall strictly"),
        ({"frames": iter(np.ones((3, 9, 9)))}, "must be equal in number, got 3 and 4"),
        ({"frames": iter(np.ones((6, 9, 9)))}, "must be equal in number, got more than 4 and 4"),
        ({"frames": iter(())}, "frames must hold"),
    ],
)
def test_contradictory_input_is_rejected_by_name(change, words):
    arguments = {"frames": np.zeros((4, 9, 9), np.uint8), "positions": np.arange(4.0), **change}
    with pytest.raises(ValueError, match=words):
        depth_from_focus(**arguments)


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


@pytest.mark.parametrize("register", [False, True])
def test_maps_of_half_the_size_are_not_held_longer_than_they_are_used(register):
    """63 bytes a pixel beyond the frames before, of which 18 are the result."""
    stack = np.tile(stack_of(4.0 + tilted_plane((128, 128), 0.05, 0.02), np.arange(9.0)), (12, 6))
    tracemalloc.start()
    depth_from_focus(stack, spacing=1, register=register)
    peak = tracemalloc.get_traced_memory()[1] / stack[0].size
    tracemalloc.stop()
    assert peak < 50


@pytest.mark.parametrize(("color", "register"), [(False, True), (True, False)])
def test_progress_rises_to_the_number_of_stages_times_that_of_frames(color, register):
    frames = stack_of(4.0 + tilted_plane((40, 44), 0.05, 0.02), np.arange(9.0))
    frames = np.repeat(frames[..., None], 3, axis=3) if color else frames
    calls = []
    progress = lambda *done: calls.append(done)  # noqa: E731
    depth_from_focus(frames, spacing=1, register=register, progress=progress)
    parts = 36 if register else 27
    assert calls[:9] == [(k + 1, parts) for k in range(9)]  # one for each frame that is read
    assert calls == sorted(calls)
    assert calls[-1] == (parts, parts)
