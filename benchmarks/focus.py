"""Shape from focus beside other measures, and what each stage contributes.

Run as ``python -m benchmarks focus``; takes two minutes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from time import process_time
from typing import Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter
from skimage import data

from benchmarks.focus_depth import drawn, render, tilted
from benchmarks.report import Limits, Tables, rms
from microlib import synthetic
from microlib.focus import depth_from_focus
from microlib.focus.multiscale._depth import RULES, FocusSettings, multiscale_depth
from tests.scenes import straight_step, tilted_plane
from tests.scenes.focus import NAMES
from tests.scenes.photographs import grey_levels, middle, photograph

#: Frames of every stack, 1 µm apart; blur grows by 1 px a frame.
POSITIONS = np.arange(21.0)
INNER = np.s_[16:-16, 16:-16]

#: Titles of the tables.
SCENE_TABLE = "RMS depth error, frame spacings"
PHOTOGRAPH_TABLE = "Photographs as texture, noise 2: RMS depth error in frames (× the best other's)"
STAGE_TABLE = "Default depth with one stage left out, over the full default"
SETTING_TABLE = "Twice and half of a setting, over the usual one"


# --- The peers: what scripts for focus stacking do, written with OpenCV alone. ------------------


def _box(image: NDArray) -> NDArray:
    return cv2.boxFilter(image, -1, (9, 9))


def _laplacian_energy(frame: NDArray) -> NDArray:
    return _box(cv2.Laplacian(frame, cv2.CV_32F) ** 2)


def _laplacian_variance(frame: NDArray) -> NDArray:
    laplacian = cv2.Laplacian(frame, cv2.CV_32F)
    return _box(laplacian**2) - _box(laplacian) ** 2


def _log_magnitude(frame: NDArray) -> NDArray:
    smooth = cv2.GaussianBlur(frame.astype(np.float32), (5, 5), 0)
    return _box(np.abs(cv2.Laplacian(smooth, cv2.CV_32F, ksize=5)))


def _ring_difference(frame: NDArray) -> NDArray:
    """The ring difference filter of Surh et al. (2017): a disc against the ring around it."""
    y, x = np.mgrid[-3:4, -3:4]
    distance = np.hypot(x, y)
    disc, ring = distance <= 1, (distance > 2) & (distance <= 3.2)
    kernel = disc / disc.sum() - ring / ring.sum()
    return _box(np.abs(cv2.filter2D(frame, cv2.CV_32F, kernel)))


def _tenengrad(frame: NDArray) -> NDArray:
    """The squared Sobel gradient (Krotkov, 1988)."""
    along, down = (cv2.Sobel(frame, cv2.CV_32F, *order) for order in ((1, 0), (0, 1)))
    return _box(along**2 + down**2)


def _grey_variance(frame: NDArray) -> NDArray:
    grey = frame.astype(float)
    return np.maximum(_box(grey**2) - _box(grey) ** 2, 0)


def _three_points(measure: Any, **options: int) -> Callable[[NDArray], NDArray]:
    return lambda stack: depth_from_focus(stack, POSITIONS, measure=measure, **options).depth


def _peer(measure: Callable[[NDArray], NDArray]) -> Callable[[NDArray], NDArray]:
    """Return a peer's method: the measure, three points through its logarithm, a 5×5 median."""

    def depth(stack: NDArray) -> NDArray:
        volume = np.log(np.maximum([measure(frame) for frame in stack], 1e-6))
        best = volume.argmax(axis=0)
        inner = np.clip(best, 1, len(stack) - 2)
        below, here, above = (
            np.take_along_axis(volume, inner[None] + k, axis=0)[0] for k in (-1, 0, 1)
        )
        second = 2 * here - below - above
        shift = np.divide(above - below, 2 * second, out=np.zeros_like(second), where=second > 0)
        result = np.where(best == inner, inner + shift, best).astype(np.float32)
        return cv2.medianBlur(result, 5)

    return depth


PLAIN = "SML 9×9, three points"
METHODS: dict[str, Callable[[NDArray], NDArray]] = {
    f"{name.upper()} {side}×{side}, three points": _three_points(name, window=side)
    for name in NAMES[1:]
    for side in (5, 9)
} | {
    "Tenengrad 9×9, three points": _three_points(_tenengrad),
    "grey variance 9×9, three points": _three_points(_grey_variance),
    "Laplacian energy, median": _peer(_laplacian_energy),
    "Laplacian variance, median": _peer(_laplacian_variance),
    "LoG magnitude, median": _peer(_log_magnitude),
    "ring difference, median": _peer(_ring_difference),
}


# --- Accuracy ------------------------------------------------------------------------------------


def scenes(seed: int) -> Iterator[tuple[str, NDArray, NDArray]]:
    """Yield name, true depth in frames, and stack."""
    middle = POSITIONS.mean()

    def stack(
        shape: tuple[int, int],
        depth: NDArray,
        noise: float,
        contrast: float = 1.0,
        *,
        patchy: bool = False,
        coarse: bool = False,
        jpeg: int = 0,
    ) -> NDArray:
        rng = np.random.default_rng(seed)
        if patchy:
            texture = synthetic.mixed_texture(shape, rng, mean=0.0)
            blobs = gaussian_filter(rng.standard_normal(shape), 24.0, mode="wrap")
            texture = 128 + texture * (0.05 + 0.95 * (blobs - blobs.min()) / np.ptp(blobs))
        else:
            scales = (2.4, 4.8, 9.6) if coarse else (0.6, 1.2, 2.4, 4.8, 9.6)
            texture = synthetic.mixed_texture(shape, rng, std=38 * contrast, scales=scales)
        frames = synthetic.focal_stack(
            texture, depth, POSITIONS, blur_rate=1.0, noise=noise, rng=rng
        )
        if jpeg:
            options = [cv2.IMWRITE_JPEG_QUALITY, jpeg]
            coded = (cv2.imencode(".jpg", frame, options)[1] for frame in frames)
            frames = np.stack([cv2.imdecode(code, cv2.IMREAD_GRAYSCALE) for code in coded])
        return frames

    large, small = (512, 512), (256, 256)
    dome = middle - 7 + synthetic.paraboloid(large, 14.0)
    yield "paraboloid, noise 1", dome, stack(large, dome, 1.0)
    yield "paraboloid, noise 5", dome, stack(large, dome, 5.0)
    dome = middle - 7 + synthetic.paraboloid(small, 14.0)
    plane = middle + tilted_plane(small, 12 / 256, 0.0)
    edge = middle - 4.3 + straight_step(small, 7.7)
    y, x = np.indices(small)
    blocks = middle + 0.3 + 3 * np.sign(np.sin(x / 20) * np.sin(y / 27))
    ball = 3 + synthetic.sphere_on_plane(small, 6.0, 6.0 / 90)
    ridge = synthetic.parabolic_cylinder(small, 20.0, width=200.0)
    relief = gaussian_filter(np.random.default_rng(seed).standard_normal(small), 6.0)
    rough = middle - 3 + synthetic.paraboloid(small, 6.0) + 0.3 * relief / relief.std()
    yield "tilted plane, noise 2", plane, stack(small, plane, 2.0)
    yield "step of 7.7, noise 2", edge, stack(small, edge, 2.0)
    yield "blocks of 6, noise 2", blocks, stack(small, blocks, 2.0)
    yield "ball on a plane, noise 2", ball, stack(small, ball, 2.0)
    yield "ridge of 20, noise 2", ridge, stack(small, ridge, 2.0)
    yield "rough dome, noise 1", rough, stack(small, rough, 1.0)
    yield "weak texture (3.8), noise 2", dome, stack(small, dome, 2.0, 0.1)
    yield "patchy texture, noise 2", dome, stack(small, dome, 2.0, patchy=True)
    yield "coarse texture, noise 2", dome, stack(small, dome, 2.0, coarse=True)
    yield "JPEG of quality 75, noise 2", dome, stack(small, dome, 2.0, jpeg=75)
    yield "texture 9.5, JPEG 85, noise 1", dome, stack(small, dome, 1.0, 0.25, jpeg=85)


def judged(truth: NDArray, stack: NDArray) -> list[float]:
    """Return our RMS error and share of NaN, and the others' RMS errors where we have a depth."""
    error = (depth_from_focus(stack, POSITIONS).depth - truth)[INNER]
    known = np.isfinite(error)
    others = [rms((depth(stack) - truth)[INNER][known]) for depth in METHODS.values()]
    others = np.nan_to_num(others, nan=np.inf).tolist()  # of one that has no depth at all
    return [rms(error), 1 - known.mean(), *others]


def accuracy(seeds: int) -> Tables:
    """Return the depth errors of all methods."""
    found: dict[str, list[list[float]]] = {}
    for seed in range(seeds):
        for name, truth, stack in scenes(seed):
            found.setdefault(name, []).append(judged(truth, stack))
    rows = []
    for name, values in found.items():
        mine, unknown, *others = np.mean(values, axis=0)
        peers = dict(zip(METHODS, others, strict=True))
        best = min(peers, key=peers.__getitem__)
        rows.append(
            {
                "scene": name,
                "microlib": round(mine, 4),
                "SML 9×9": round(peers[PLAIN], 3),
                "best other": round(peers[best], 3),
                "which": best,
                "ratio": round(mine / peers[best], 2),
                "share of NaN": round(unknown, 4),
            }
        )
    return {SCENE_TABLE: pd.DataFrame(rows)}


# --- Photographs as texture ----------------------------------------------------------------------

#: Photographs that come with scikit-image: strong edges, fine grain, and places with no texture.
PHOTOGRAPHS = (
    *("astronaut", "brick", "camera", "cell", "chelsea", "clock", "coffee", "coins", "grass"),
    *("gravel", "hubble_deep_field", "immunohistochemistry", "microaneurysms", "moon", "page"),
    *("retina", "text"),
)


#: Those of them on which the stages are left out, one at a time.
STAGE_PHOTOGRAPHS = ("brick", "camera", "clock", "coins", "moon", "retina")


def photographed() -> Iterator[tuple[str, str, NDArray, NDArray]]:
    """Yield photograph, surface, true depth in frames, and stack."""
    side = 256
    shape = (side, side)
    surfaces = {
        "dome": POSITIONS.mean() - 7 + synthetic.paraboloid(shape, 14.0),
        "step": POSITIONS.mean() - 4.3 + straight_step(shape, 7.7),
        "ball": 3 + synthetic.sphere_on_plane(shape, 6.0, 6.0 / 90),
    }
    for name in PHOTOGRAPHS:
        grey = photograph(name)
        grey = np.pad(grey, [(0, max(side - n, 0)) for n in grey.shape], mode="symmetric")
        texture = middle(grey, side)
        for surface, depth in surfaces.items():
            yield name, surface, depth, rendered(texture, depth)
    # A stereo pair, whose disparity is the depth of what the photograph shows.
    left_view, _, disparity = data.stereo_motorcycle()
    window = np.s_[100:484, 150:534]
    disparity = disparity[window]
    unknown = ~np.isfinite(disparity)
    nearest = distance_transform_edt(unknown, return_distances=False, return_indices=True)
    disparity = disparity[tuple(nearest)]
    depth = 3 + 14 * (disparity - disparity.min()) / np.ptp(disparity)
    yield "stereo_motorcycle", "its own", depth, rendered(grey_levels(left_view)[window], depth)


def rendered(texture: NDArray, depth: NDArray) -> NDArray:
    """Return the frames of a texture on a surface, with noise of 2 grey levels."""
    rng = np.random.default_rng(0)
    return synthetic.focal_stack(texture, depth, POSITIONS, blur_rate=1.0, noise=2.0, rng=rng)


def photographs() -> pd.DataFrame:
    """Return each photograph's errors on all surfaces, and the ratios to the best other's."""
    errors: dict[str, dict[str, str]] = {}
    shares: dict[str, list[float]] = {}
    for name, surface, truth, stack in photographed():
        mine, unknown, *others = judged(truth, stack)
        shown = f"{mine:.3f} (×{mine / min(others):.2f})"
        errors.setdefault(name, {})[f"{surface}: error"] = shown
        shares.setdefault(name, []).append(unknown)
    table = pd.DataFrame(errors).T.fillna("")
    table.insert(0, "photograph", [name.replace("_", " ") for name in errors])
    table["share of NaN"] = [round(float(np.mean(each)), 3) for each in shares.values()]
    return table


# --- What the stages and settings of the default depth contribute --------------------------------


def _measured(stacks: list, **options: Any) -> NDArray:
    """Return RMS error, share of NaN and of gross errors of each stack, and the time a stack."""
    rows = []
    for truth, stack in stacks:
        start = process_time()
        depth = multiscale_depth(list(stack), np.arange(float(len(stack))), **options).depth
        time = process_time() - start
        error = (depth - truth)[INNER]
        rows.append((rms(error), np.isnan(error).mean(), np.mean(np.abs(error) > 1), time))
    return np.array(rows)


def _compared(found: NDArray, full: NDArray) -> dict[str, str]:
    ratio = found[:, 0] / full[:, 0]
    unknown, gross = 100 * (found - full)[:, 1:3].mean(axis=0)
    mean = np.exp(np.log(ratio).mean())
    return {
        "RMS": f"{mean:.2f} ({ratio.min():.2f} to {ratio.max():.2f})",
        "NaN": f"{unknown:+.2f}",
        "off by > 1 frame": f"{gross:+.2f}",
    }


def stages() -> pd.DataFrame:
    """Return what happens to the default depth without each of its rules and some other stages."""
    dense = render(drawn(0), tilted(), 0, noise=3.0, factor=4)  # truth in its frames
    cases = {
        "scenes": [
            *((truth, stack) for _, truth, stack in scenes(0)),
            (4 * dense.depth, dense.stack),
        ],
        "photographs": [
            (truth, stack) for name, _, truth, stack in photographed() if name in STAGE_PHOTOGRAPHS
        ],
    }
    full = {kind: _measured(stacks) for kind, stacks in cases.items()}
    # A setting that no peak reaches turns its stage off.
    without: dict[str, dict[str, Any]] = {
        "averaged frames": {"settings": FocusSettings(width=np.inf)},
        "wide windows": {"settings": FocusSettings(wide_slope=0.0)},
        "smoothing": {"settings": FocusSettings(smoothing_sigma=0.1)},
        "relief": {"settings": FocusSettings(snr_low=1e9, snr_high=2e9)},
    }
    for left_out in RULES:
        rules = [rule for rule in RULES if rule is not left_out]
        without[left_out.__name__.replace("_", " ")] = {"rules": rules}
    rows = []
    for name, options in without.items():
        row, spent = {"without": name}, []
        for kind, stacks in cases.items():
            found = _measured(stacks, **options)
            spent.append(found[:, 3].sum() / full[kind][:, 3].sum())
            row |= {f"{kind}: {k}": v for k, v in _compared(found, full[kind]).items()}
        rows.append(row | {"time": round(float(np.mean(spent)), 2)})
    return pd.DataFrame(rows)


def settings() -> pd.DataFrame:
    """Return the errors with each setting halved and doubled."""
    cases = [
        (truth, stack)
        for name, truth, stack in scenes(0)
        if name.startswith(("step", "ball", "ridge", "rough", "weak"))
    ]
    cases += [
        (truth, stack)
        for name, surface, truth, stack in photographed()
        if (name, surface) in {("coins", "dome"), ("clock", "step"), ("moon", "ball")}
    ]
    full = _measured(cases)
    rows = []
    for field in fields(FocusSettings):
        usual = getattr(FocusSettings(), field.name)
        row: dict[str, object] = {"setting": field.name, "usual": str(usual)}
        for factor in (0.5, 2.0):
            value = (
                tuple(factor * part for part in usual)
                if isinstance(usual, tuple)
                else int(factor * usual) | 1  # sides of windows are odd
                if isinstance(usual, int)
                else factor * usual
            )
            changed = replace(FocusSettings(), **{field.name: value})
            found = _compared(_measured(cases, settings=changed), full)
            row |= {f"×{factor:g}: {k}": v for k, v in found.items()}
        rows.append(row)
    return pd.DataFrame(rows)


def limits(tables: Tables) -> Limits:
    scenes = tables[SCENE_TABLE].set_index("scene")
    error, ratio = scenes["microlib"], scenes["ratio"]
    paraboloids = ["paraboloid, noise 1", "paraboloid, noise 5"]
    others = ratio.drop(paraboloids)
    photos = tables[PHOTOGRAPH_TABLE].filter(like="error").stack().str.extract(r"×([\d.]+)")[0]
    photos = photos.dropna().astype(float)
    return [
        ("paraboloid, noise 1: RMS error, frames", error[paraboloids[0]], "≤", 0.045),
        ("paraboloid, noise 5: RMS error, frames", error[paraboloids[1]], "≤", 0.050),
        (f"error over the best other's, worst of {len(others)} scenes", others.max(), "≤", 0.75),
        (f"the same, worst of {len(photos)} with photographs", photos.max(), "≤", 0.75),
    ]


NOTE = """\
Depth errors are means over the seeds, with the default settings for all scenes and without the
outermost 16 px.

- *Peers.* On photographs, the errors of the other methods are computed only at pixels with a depth
  of `microlib`. The rules that reject a depth were developed with the domes of brick, camera,
  coins and moon. The other photographs were not used before. The stereo scene misses the limit of
  0.75, because of its vertical edges. Of the drawn scenes, the blocks (0.94) and the ball (0.76)
  miss it because of their edges, and the rough dome (0.81) because its relief is finer than the
  window of the smoothing.
- *Stages* and *settings.* One stage of the method is left out, or one setting is changed. Each row
  has the ratio of the RMS error to the RMS error of the full default (geometric mean, smallest and
  largest). It also has the change of two shares, in percent of all pixels: the pixels without a
  depth, and the pixels that are wrong by more than a frame. The data are 13 scenes of one
  seed, a slope in four times the frames, and all surfaces of six photographs. Without a stage of
  the method, more pixels can have a depth and count in the error. A ratio below 1 together with
  more unknown pixels is therefore not an improvement.
- *Steps of the surface.* Unlike version 0.5.0, the method does not fit a second time at full size,
  which took up to a fifth of the time. The errors on blocks are twice those of 0.5.0, and those on
  the step and the ball 1.3 times. With photographs as texture, the errors on steps are 9 % smaller
  and those on balls 3 % smaller (geometric means). Photographs are more like real parts than the
  drawn texture of the blocks, so the second fit was not restored.
"""


def main() -> tuple[Tables, Limits]:
    tables = accuracy(2)
    tables |= {
        PHOTOGRAPH_TABLE: photographs(),
        STAGE_TABLE: stages(),
        SETTING_TABLE: settings(),
    }
    return tables, limits(tables)
