"""From image to modulus on 100 rendered embryos; LOESS beside statsmodels. About six minutes.

Run as ``python -m benchmarks embryo``.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from time import process_time
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.interpolate import make_smoothing_spline
from statsmodels.nonparametric.smoothers_lowess import lowess

from benchmarks.capsule_embryo import errors_of
from benchmarks.photographs import without_embryo
from benchmarks.report import Limits, Tables, paired_times
from compendium.experiments.section_5_6 import thesis_dimple
from microlib.embryo import extract_boundary, fit_dimple, loess, modulus_from_image
from microlib.embryo._boundary import Settings, find_boundary
from microlib.membrane import SmallSlopeWarning, elastic_modulus, modulus_std
from microlib.synthetic import Embryo, embryo_image
from microlib.synthetic._embryo import EmbryoImage

EMBRYOS = 100
CHOICES_TITLE = "Other settings (9 embryos, three of them with other noise or blur)"
#: Settings of the stages from image to outline, each with other values than the library's.
CHOICES = {
    "blur_reach": (2.0, 4.5),
    "edge_blur": (1.0, 2.0),
    "profile_reach": (4.0, 7.0),
    "smoothing": (7, 17),
    "largest_std": (4.0, 10.0),
    "reach": (1.8, 3.5),
    "usual_width": (0.8, 1.6),
    "search_step": (0.1, 0.5),
    "iterations": (3, 10),
    "every": (1, 8),
}
MEMBRANE = {"thickness": 3.0, "probe_half_width": 25.0, "poisson_ratio": 0.5}


def draw_scene(
    seed: int,
    columns: tuple[float, float] = (360.0, 660.0),
    rows: tuple[float, float] = (190.0, 310.0),
    **options: Any,
) -> EmbryoImage:
    """Render an embryo of random stiffness, dimple, place, turn and light; noise of 2/255."""
    rng = np.random.default_rng(seed)
    embryo = Embryo.dented(
        rng.uniform(40.0, 150.0), modulus=rng.uniform(0.5, 2.0), rim_radius=rng.uniform(350, 600)
    )
    return embryo_image(
        embryo,
        rng=rng,
        center=(rng.uniform(*columns), rng.uniform(*rows)),
        tilt=np.deg2rad(rng.uniform(-1.5, 1.5)),
        unevenness=rng.uniform(0.0, 0.2),
        **options,
    )


def usual_scene(seed: int, **options: Any) -> EmbryoImage:
    """Render an embryo of 1 MPa and a random dimple, with other light or noise."""
    rng = np.random.default_rng(seed)
    embryo = Embryo.dented(rng.uniform(40.0, 150.0), modulus=1.0)
    return embryo_image(embryo, rng=rng, **options)


def modulus_of(dimple: Any, force: float) -> tuple[float, float]:
    """Return the modulus by (4.3) and its relative standard deviation."""
    sizes = {"dimple_radius": dimple.dimple_radius, "dimple_depth": dimple.dimple_depth}
    values = sizes | MEMBRANE | {"force": force}
    found = float(elastic_modulus(**values))
    return found, modulus_std(values, {}, dimple_covariance=dimple.covariance) / found


def spline_modulus(image: NDArray, force: float, pixel_size: float) -> float:
    """Modulus from the left rim of a smoothing spline and the end of the probe."""
    boundary = extract_boundary(image)
    middle = boundary.probe.tip[0]
    x = np.arange(np.ceil(boundary.x[0]), boundary.x[-1])
    curve = make_smoothing_spline(x, np.interp(x, boundary.x, boundary.y))
    fine = np.arange(x[0], x[-1], 0.02)
    height = curve(fine)
    rim = np.where(fine < middle, height, -np.inf).argmax()
    bottom = boundary.image_height - 1 - boundary.probe.tip[1]
    radius = (middle - fine[rim]) * pixel_size
    depth = (height[rim] - bottom) * pixel_size
    return float(elastic_modulus(force, radius, depth, **MEMBRANE))


def characterize(seed: int) -> list[dict[str, object]]:
    """Measure one embryo by every method; an error is a failure and no number."""
    scene = draw_scene(seed)
    truth = scene.embryo
    rows = []
    for method in ("membrane", "gaussians", "spline"):
        row: dict[str, object] = {"seed": seed, "method": method, "depth": truth.dimple_depth}
        start = process_time()
        try:
            if method == "membrane":
                estimate = modulus_from_image(
                    scene.image, truth.force, pixel_size=scene.pixel_size, **MEMBRANE
                )
                found, std = estimate.modulus, estimate.relative_std
            elif method == "spline":
                found = spline_modulus(scene.image, truth.force, scene.pixel_size)
                std = np.nan
            else:
                dimple = thesis_dimple(extract_boundary(scene.image))
                found, std = modulus_of(dimple, truth.force)
            row |= {"error": np.log(found / truth.modulus), "std": std}
        except ValueError as reason:
            row |= {"error": np.nan, "std": np.nan, "reason": str(reason)}
        rows.append(row | {"seconds": process_time() - start})
    return rows


def summarise(runs: pd.DataFrame) -> pd.DataFrame:
    """One row a method: failures, bias and spread of ln E, coverage of the stated interval."""
    names = {
        "membrane": "profile (4.2) fitted (microlib)",
        "gaussians": "LOESS and eight Gaussians (thesis)",
        "spline": "rim of a smoothing spline (scipy), end of the probe",
    }
    rows = []
    for method, group in runs.groupby("method", sort=False):
        row = {"method": names[str(method)]} | errors_of(group)
        rows.append(row | {"CPU s an image, longest": group["seconds"].max()})
    return pd.DataFrame(rows).round(3)


def limits(runs: pd.DataFrame, foreign: pd.DataFrame) -> Limits:
    ours = runs[runs["method"] == "membrane"]
    error = ours["error"]
    holds = 100 * (error.abs() < 1.96 * ours["std"]).mean()
    return [
        ("failures of 100 embryos", error.isna().sum(), "≤", 0),
        ("bias of E, %", 100 * abs(error.mean()), "≤", 1),
        ("spread of E, %", 100 * error.std(), "≤", 5),
        ("95 % intervals that hold, %", holds, "≥", 90),
        ("95 % intervals that hold, %", holds, "≤", 98),
        ("CPU time of an image, longest, s", ours["seconds"].max(), "≤", 1),
        ("pictures of other things given a modulus", foreign["given a modulus"][0], "≤", 0),
        ("errors of another kind on them", foreign["another error"][0], "≤", 0),
    ]


def others(count: int = 430) -> pd.DataFrame:
    """What the chain makes of images that show no indented embryo."""
    outcomes = {"refused with the reason": 0, "given a modulus": 0, "another error": 0}
    for _, image in without_embryo(np.random.default_rng(0), count):
        try:
            modulus_from_image(image, 100.0, pixel_size=4.65 / 1.2, **MEMBRANE)
            outcomes["given a modulus"] += 1
        except ValueError:
            outcomes["refused with the reason"] += 1
        except Exception:
            outcomes["another error"] += 1
    return pd.DataFrame([{"images": count} | outcomes])


def conditions(count: int = 12) -> pd.DataFrame:
    """Bias and spread under more noise and blur than the workstation's."""
    rows = []
    for noise, blur in ((0.0, 1.0), (2.0, 1.0), (4.0, 1.0), (8.0, 1.0), (2.0, 0.7), (2.0, 1.5)):
        errors = []
        for seed in range(count):
            scene = usual_scene(1000 + seed, noise=noise, blur=blur)
            try:
                estimate = modulus_from_image(
                    scene.image, scene.embryo.force, pixel_size=scene.pixel_size, **MEMBRANE
                )
                errors.append(np.log(estimate.modulus))
            except ValueError:
                errors.append(np.nan)
        rows.append(
            {
                "noise (of 255)": noise,
                "blur (px)": blur,
                "failures": int(np.isnan(errors).sum()),
                "bias of E (%)": 100 * np.nanmean(errors),
                "spread of E (%)": 100 * np.nanstd(errors, ddof=1),
            }
        )
    return pd.DataFrame(rows).round(2)


def small_scenes() -> list:
    """The dimple's side of six embryos like those of `draw_scene`, and of three in other light."""
    small = (360, 600)
    columns, rows = (230.0, 370.0), (90.0, 130.0)
    scenes = [draw_scene(700 + seed, columns, rows, shape=small) for seed in range(6)]
    for seed, (noise, blur) in enumerate(((8.0, 1.0), (4.0, 1.5), (0.0, 1.0))):
        options = {"center": (300.0, 100.0), "noise": noise, "blur": blur}
        scenes.append(usual_scene(800 + seed, shape=small, **options))
    return scenes


def choices(scenes: list) -> pd.DataFrame:
    """What other settings of the chain do to E, beside what E is sure of."""

    def measure(settings: Settings) -> np.ndarray:
        found = []
        for scene in scenes:
            try:
                boundary = find_boundary(scene.image, "auto", True, settings)
                dimple = fit_dimple(boundary, pixel_size=scene.pixel_size, probe_half_width=25.0)
                modulus, std = modulus_of(dimple, scene.embryo.force)
                found.append((np.log(modulus), std))
            except ValueError:
                found.append((np.nan, np.nan))
        return np.array(found).T

    usual, stds = measure(Settings())
    rows = []
    for name, others in CHOICES.items():
        found = [measure(replace(Settings(), **{name: value}))[0] for value in others]
        changes = np.abs(found - usual)
        rows.append(
            {
                "setting": name,
                "value": f"{getattr(Settings(), name):g}",
                "instead": " or ".join(f"{value:g}" for value in others),
                "refused, at most": int(np.isnan(changes).sum(axis=1).max()),
                "largest change of E (%)": 100 * np.nanmax(changes),
                "in its own deviations": np.nanmax(changes / stds),
            }
        )
    return pd.DataFrame(rows).round(2)


def smoothers() -> pd.DataFrame:
    """`loess` of degree 1 beside statsmodels' lowess: largest difference and time."""
    rows = []
    for points in (300, 1000, 3000):
        rng = np.random.default_rng(points)
        x = np.sort(rng.uniform(0.0, 300.0, points))
        y = 30.0 * np.sin(x / 30.0) + rng.normal(0.0, 0.3, points)

        def ours(x=x, y=y):
            return loess(x, y, span=0.25, degree=1)

        def peer(x=x, y=y):
            return lowess(y, x, frac=0.25, it=0, return_sorted=False)

        mine, theirs, ratio = paired_times(ours, peer)
        rows.append(
            {
                "points": points,
                "largest difference": np.abs(ours() - peer()).max(),
                "microlib (ms)": round(1e3 * mine, 2),
                "statsmodels (ms)": round(1e3 * theirs, 2),
                "microlib / statsmodels": round(ratio, 2),
            }
        )
    return pd.DataFrame(rows)


NOTE = """\
The rendered embryos have a modulus of 0.5 to 2 MPa and dimples 40 to 150 µm deep. The noise is 2
of 255 grey levels; light, place and turn vary. Each method starts from the image and is given the
force, the pixel size, the thickness, the width of the probe and Poisson's ratio.
"""


def main() -> tuple[Tables, Limits]:
    warnings.simplefilter("ignore", SmallSlopeWarning)  # the scenes obey the model by construction
    runs = pd.DataFrame([row for seed in range(EMBRYOS) for row in characterize(seed)])
    foreign = others()
    tables = {
        "Modulus of 100 rendered embryos by method": summarise(runs),
        "More noise and blur (12 embryos each)": conditions(),
        "Pictures, pieces of them and textures without an embryo": foreign,
        "LOESS of the first degree": smoothers(),
        CHOICES_TITLE: choices(small_scenes()),
    }
    return tables, limits(runs, foreign)
