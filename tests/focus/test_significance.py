"""Ground without texture, whatever its noise; asymmetric peaks; thin things; margins; changes."""

import warnings

import cv2
import numpy as np
import pytest

from compendium.experiments.disc_blur import disc_blur
from compendium.experiments.uncertainty import expose
from microlib import synthetic
from microlib.focus import depth_from_focus
from tests.scenes import tilted_plane

KINDS = ("white", "quantized", "smoothed", "demosaiced", "jpeg", "cropped jpeg")


def bare(kind: str, rng: np.random.Generator) -> np.ndarray:
    """Frames of a uniform wall with noise of one kind, of a random level, count and quality."""
    count, grey = int(rng.choice([3, 5, 9, 21])), rng.uniform(20, 220)
    noise, quality = 10 ** rng.uniform(-0.5, 0.7), int(rng.integers(60, 99))
    sigma = rng.uniform(0.7, 1.5)  # of one camera
    frames = []
    for _ in range(count):
        rough = noise * rng.standard_normal((136, 136, 3))
        if kind == "quantized":
            rough *= 0.25
        if kind == "smoothed":
            rough = cv2.GaussianBlur(3 * rough, (0, 0), sigma)
        image = np.clip(np.rint(grey + rough), 0, 255).astype(np.uint8)
        if kind == "demosaiced":
            image = cv2.cvtColor(np.ascontiguousarray(image[..., 0]), cv2.COLOR_BayerBG2BGR)
        if "jpeg" in kind:
            code = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
            image = cv2.imdecode(code, cv2.IMREAD_COLOR)
        if kind == "cropped jpeg":
            image = image[3:, 5:]
        frames.append(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
    return np.array(frames)


@pytest.mark.parametrize("measure", ["multiscale", "sml"])
@pytest.mark.parametrize("kind", KINDS)
def test_ground_without_texture_has_no_certain_depth(kind, measure):
    """Eight stacks each; at 0.4.0 up to all of their pixels had one."""
    rng = np.random.default_rng(KINDS.index(kind) + 50)
    certain = []
    for _ in range(8):
        frames = bare(kind, rng)
        found = depth_from_focus(frames, np.arange(float(len(frames))), measure=measure)
        certain.append(np.mean(found.uncertainty < (len(frames) - 1) / 5))
    assert np.mean(certain) <= 0.02


def bad_frame(kind: str, stack: np.ndarray, place: int, rng: np.random.Generator) -> np.ndarray:
    """What a camera may give instead of one frame of a stack."""
    frame = stack[place].astype(float)
    image = {
        "black": 0 * frame,
        "white": 0 * frame + 255,
        "frozen": stack[place - 1],
        "brighter": frame * rng.uniform(1.25, 2.5),
        "with a reflection": frame + rng.uniform(40, 90),
        "darker": frame * rng.uniform(0.2, 0.7),
        "behind a shutter": rng.normal(4, 3, frame.shape),
    }[kind]
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


BAD = ("black", "white", "frozen", "brighter", "with a reflection", "darker", "behind a shutter")


@pytest.mark.parametrize("kind", BAD)
def test_one_bad_frame_changes_only_heights_at_that_frame(kind: str) -> None:
    """Five stacks each; at 0.4.0 up to all of the bare ground had a certain depth."""
    rng = np.random.default_rng(BAD.index(kind))
    bare = {"multiscale": [], "sml": []}
    for case in range(5):
        count = int(rng.choice([7, 9, 13, 21]))
        texture = synthetic.mixed_texture((112, 144), rng)
        texture[:, 64:] = rng.uniform(60, 140)
        z = 8.0 * np.arange(count)
        depth = np.full(texture.shape, rng.uniform(0.35, 0.65) * z[-1])
        noise = 10 ** rng.uniform(-0.3, 0.7)
        stack = synthetic.focal_stack(texture, depth, z, blur_rate=0.1, noise=noise, rng=rng)
        best = int(np.argmin(np.abs(z - depth[0, 0])))
        first = 1 if kind == "frozen" else 0  # which has none before it
        place = [first, count - 1, int(rng.integers(1, count - 1)), best, 1][case]
        stack[place] = bad_frame(kind, stack, place, rng)
        for measure, certain in bare.items():
            with pytest.warns(UserWarning, match=f"frames {place} are .*: left out"):
                found = depth_from_focus(stack, z, measure=measure)
            certain.append(np.mean(found.uncertainty[:, 88:] < 0.2 * z[-1]))
            assert not np.any(found.index == place)
            error, stated = (
                part[8:-8, 8:48] for part in (np.abs(found.depth - depth), found.uncertainty)
            )
            assert np.isfinite(error).mean() > 0.98
            # A tenth of the distance of the frames is peak locking.
            assert np.mean(error < 3 * stated + 0.8) > 0.95
    assert all(np.mean(certain) <= 0.02 for certain in bare.values())


def test_frames_of_a_stack_that_changes_smoothly_or_at_random_are_not_left_out() -> None:
    rng, z = np.random.default_rng(4), np.arange(9.0)
    texture = synthetic.mixed_texture((96, 112), rng)
    depth = np.full(texture.shape, 4.2)
    stack = synthetic.focal_stack(texture, depth, z, blur_rate=1.0, noise=1.0, rng=rng)
    lamps = [0.9**z, 0.5 + 0.05 * z, 0.8 - 0.03 * (z - 4) ** 2, rng.uniform(0.6, 1.0, 9)]
    for lamp in lamps:
        frames = np.rint(lamp[:, None, None] * stack).astype(np.uint8)
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            depth_from_focus(frames, z, measure="sml")
        assert not any("left out" in str(note.message) for note in warned)


def lens_stack(rng: np.random.Generator, depth: np.ndarray, q: float, rate: float) -> np.ndarray:
    """30 frames of a lens that moves: blur grows as |1/a − 1/b|, with its vertex q frames away."""
    texture = np.asarray(synthetic.mixed_texture(depth.shape, rng), np.float32)
    blurs = np.concatenate([np.arange(0.05, 3, 0.1), np.arange(3, 60, 0.5)])
    ladder = np.array([cv2.GaussianBlur(texture, (0, 0), sigma) for sigma in blurs])
    frames = []
    for k in range(30):
        blur = np.clip(rate * (q + depth) * np.abs(k - depth) / (q + k), blurs[0], blurs[-2])
        below = np.searchsorted(blurs, blur, side="right") - 1
        part = (blur - blurs[below]) / (blurs[below + 1] - blurs[below])
        low, high = (np.take_along_axis(ladder, (below + n)[None], 0)[0] for n in (0, 1))
        frames.append(low * (1 - part) + high * part + rng.normal(0, 1, depth.shape))
    return np.clip(np.rint(frames), 0, 255).astype(np.uint8)


def test_asymmetric_peaks_give_depths_within_what_is_stated():
    """Eight random lenses; at 0.4.0 medians were off by up to 0.67 frames, stated as 0.02."""
    rng = np.random.default_rng(5)
    for _ in range(8):
        q, low, high = 10 ** rng.uniform(0.8, 1.8), *np.sort(rng.uniform(8, 22, 2))
        depth = (low + (high - low) * np.linspace(0, 1, 112) * np.ones((96, 1))).T
        found = depth_from_focus(lens_stack(rng, depth, q, 10 ** rng.uniform(-0.5, 0.0)), spacing=1)
        error = (found.depth - depth)[8:-8, 8:-8]
        stated = np.sqrt(np.mean(found.uncertainty[8:-8, 8:-8] ** 2))
        assert abs(np.median(error)) < 0.1
        assert np.sqrt(np.mean(error**2)) < 2 * stated + 0.02  # peak locking of narrow peaks


@pytest.mark.parametrize("width", [4, 5, 6, 8, 10])
def test_wrong_depth_of_a_thin_bar_is_uncertain(width: int) -> None:
    """Bars in random directions, 5 and 12 frames above ground of the same texture, ten draws.

    At 0.4.0 61 % of the pixels of bars of 4 px were wrong and certain, and 20 % at 8 px.
    """
    rng, z, wrong = np.random.default_rng(width), 5.0 * np.arange(21), []

    def spread(image, away):
        return cv2.GaussianBlur(image, (0, 0), max(0.12 * abs(away), 0.3))

    y, x = np.mgrid[-71.5:72, -71.5:72]
    for above in 5 * (25.0, 60.0):
        turn, near = rng.uniform(0, np.pi), rng.uniform(18, 22)
        distance = np.abs(x * np.cos(turn) + y * np.sin(turn))
        mask = np.clip(width / 2 + 0.5 - distance, 0, 1)
        textures = [np.asarray(synthetic.mixed_texture(x.shape, rng), float) for _ in range(2)]
        ground, bar = ((image - image.min()) / np.ptp(image) for image in textures)
        frames = [
            40
            + 150 * spread(mask * bar, v - near)
            + 150 * (1 - spread(mask, v - near)) * spread(ground, v - near - above)
            for v in z
        ]
        frames = np.clip(np.rint(frames + rng.normal(0, 1, (21, *x.shape))), 0, 255)
        found = depth_from_focus(frames.astype(np.uint8), z)
        here = slice(10, -10), slice(10, -10)
        error, stated = np.abs(found.depth - near)[here], found.uncertainty[here]
        wrong.append(np.mean((error > np.maximum(3 * stated, 5))[mask[here] > 0.99]))
    assert np.mean(wrong) < 0.05


@pytest.mark.parametrize("quality", [None, 60, 90])
def test_black_margins_of_aligned_frames_have_no_depth(quality: int | None) -> None:
    texture = synthetic.mixed_texture((96, 120), np.random.default_rng(0))
    height = tilted_plane(texture.shape, 0.0, 0.7) + 40
    stack = synthetic.focal_stack(texture, height, 10.0 * np.arange(9), blur_rate=0.1)
    for k, frame in enumerate(stack):
        frame[:, : max(2 * (k - 4), 0)] = 0
        frame[96 - max(3 * (4 - k), 0) :] = 0
        if quality:
            code = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
            frame[:] = cv2.imdecode(code, cv2.IMREAD_GRAYSCALE)
    with pytest.warns(UserWarning, match="black margins"):
        found = depth_from_focus(stack, spacing=10.0)
    assert np.isnan(found.depth[:, :8]).all()
    assert np.isnan(found.depth[-12:]).all()
    off = np.abs(found.depth - height) > 3 * found.uncertainty + 1
    assert off.mean() < 0.02
    inner = found.depth[10:-24, 20:-10]
    assert np.isfinite(inner).mean() > 0.98


def test_object_on_dark_ground_has_no_margin() -> None:
    rng, z = np.random.default_rng(6), 10.0 * np.arange(9)
    texture = np.asarray(synthetic.mixed_texture((112, 128), rng), float)
    y, x = np.mgrid[:112, :128]
    texture *= np.hypot(x - 64, y - 56) < 40
    stack = synthetic.focal_stack(
        texture, np.full(y.shape, 41.0), z, blur_rate=0.1, noise=1.0, rng=rng
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = depth_from_focus(stack, z)
    assert np.isfinite(found.depth[np.hypot(x - 64, y - 56) < 30]).mean() > 0.98


@pytest.mark.parametrize("measure", ["multiscale", "sml"])
def test_drift_and_flicker_are_told_with_the_option_that_undoes_them(measure):
    rng, z = np.random.default_rng(1), np.arange(11.0)
    texture = synthetic.mixed_texture((128, 160), rng)
    rest = synthetic.focal_stack(texture, np.full(texture.shape, 5.3), z, blur_rate=1.0, rng=rng)
    depth_from_focus(rest, z, measure=measure)  # warns of nothing
    moved = np.array([np.roll(frame, k, axis=1) for k, frame in enumerate(rest)])
    gains = 1 + 0.1 * rng.uniform(-1, 1, (11, 1, 1))
    for stack, word in ((moved, "position"), ((0.8 * gains * rest).astype(np.uint8), "light")):
        with pytest.warns(UserWarning, match=f"change in {word} .*register=True"):
            depth_from_focus(stack, z, measure=measure)


@pytest.mark.parametrize("measure", ["multiscale", "sml"])
@pytest.mark.parametrize("height", [-15.0, 115.0])
def test_uncertainty_of_heights_beyond_the_scan_is_that_of_a_random_depth(
    measure: str, height: float
) -> None:
    texture = synthetic.mixed_texture((64, 72), np.random.default_rng(0))
    positions = np.arange(0, 110.0, 10)
    depth = np.full(texture.shape, height)
    frames = synthetic.focal_stack(texture, depth, positions, blur_rate=0.1, noise=2.0, rng=1)
    found = depth_from_focus(frames, positions, measure=measure)
    at_end = found.at_end & np.isfinite(found.depth)
    assert at_end.mean() > 0.3
    assert np.mean(found.uncertainty[at_end] >= np.float32(100 / np.sqrt(12))) > 0.98


@pytest.mark.parametrize(("measure", "least"), [("multiscale", 0.9), ("sml", 0.6)])
def test_intervals_contain_heights_whatever_the_shape_of_the_peaks(measure, least):
    """Eight random planes behind a lens that moves; before, the shares were 0.54 and 0.58.

    Blur is a disc or a Gaussian, so that peak locking differs. A bias is common to a whole plane,
    so the share of one plane is near 0 or 1. With "sml" two of the eight are not covered.
    """
    rng, held, k = np.random.default_rng(11), [], np.arange(21.0)
    for case in range(8):
        texture = np.asarray(synthetic.mixed_texture((128, 128), rng), np.float32)
        vertex, best = 10 ** rng.uniform(0.8, 1.7), rng.uniform(9, 12)
        radii = rng.uniform(0.7, 1.0) * (vertex + best) * np.abs(k - best) / (vertex + k)
        blurred = [
            disc_blur(texture, radius)
            if case % 2
            else cv2.GaussianBlur(texture, (0, 0), np.hypot(0.5, radius / 2))
            for radius in radii
        ]
        stack = np.stack([expose(image, rng) for image in blurred])
        found = depth_from_focus(stack, k, measure=measure)
        inside = np.abs(found.depth - best) < 1.96 * found.uncertainty
        held.append(np.mean(inside[12:-12, 12:-12]))
    assert np.mean(held) > least, np.round(held, 2)
