"""What may have happened in §5.4: the unknown numbers, their priors, and the disturbances.

A prior says what the data sheet of such a part, the thesis' own text, or the image allows, and not
what the tables want. Data sheets are taken by their order of magnitude, with room on both sides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import ndtr

from compendium import thesis
from compendium.experiments.section_5_4 import CALIBRATION_ANGLE, CALIBRATION_SCALE
from compendium.experiments.servo_loop import COLUMNS, EXPERIMENTS


@dataclass(frozen=True)
class Prior:
    """How likely a number was before the tables were read.

    Attributes
    ----------
    name, unit : str
        Of the number.
    low, high : float
        Ends of the range; for the shape ``normal``, mean and standard deviation.
    shape : str
        ``log`` (even in the logarithm), ``even`` or ``normal``.
    reason : str
        Why these.
    """

    name: str
    unit: str
    low: float
    high: float
    shape: str
    reason: str

    def value(self, normal: NDArray) -> NDArray:
        """Return the number that stands for a standard normal one."""
        if self.shape == "normal":
            return self.low + self.high * normal
        share = ndtr(normal)
        if self.shape == "even":
            return self.low + (self.high - self.low) * share
        return self.low * (self.high / self.low) ** share


_FASTEST = "from what crosses the 1X step in three seconds to the fastest such stages"
_DRAWN = "the two patterns of Table 5.1 agree as well"
#: Numbers that every model has.
BASE = (
    Prior("speed limit at 1X", "µm/s", 100.0, 1500.0, "log", _FASTEST),
    Prior("speed limit at 4X", "µm/s", 50.0, 1500.0, "log", "the same; the step is shorter"),
    Prior(
        "latency",
        "ms",
        0.0,
        1000 * thesis.FRAME_INTERVAL,
        "even",
        "at most a frame, or the loop would fall behind the camera",
    ),
    Prior("image noise", "px", 0.02, 1.0, "log", "from a template tracker at its best to a pixel"),
    Prior("speed on the circle", "px/s", 5.0, 100.0, "log", "a turn in 2.5 s to 50 s"),
    Prior("speed on the square", "px/s", 5.0, 100.0, "log", "likewise"),
    Prior("speed on the sinusoid", "px/s", 5.0, 100.0, "log", "likewise"),
    Prior("path size", "of ours", 0.5, 2.0, "log", "the path fills a tenth to half of the image"),
    Prior("sinusoid height", "of ours", 0.4, 2.5, "log", "from flat to steep"),
    Prior("angle error at 1X", "°", 0.0, np.degrees(CALIBRATION_ANGLE), "normal", _DRAWN),
    Prior("angle error at 4X", "°", 0.0, np.degrees(CALIBRATION_ANGLE), "normal", _DRAWN),
    Prior("scale error at 1X", "%", 0.0, 100 * CALIBRATION_SCALE, "normal", _DRAWN),
    Prior("scale error at 4X", "%", 0.0, 100 * CALIBRATION_SCALE, "normal", _DRAWN),
)
_RARE = "from once in ten seconds to every third frame"
_LOST = "with more the tracker loses its way"
#: What each model adds.
MECHANISMS: dict[str, tuple[Prior, ...]] = {
    "base": (),
    "stage noise": (
        Prior("stage noise", "µm", 0.02, 5.0, "log", "from under a step to twice the backlash"),
    ),
    "stage jumps": (
        Prior("jump rate", "of frames", 0.003, 0.3, "log", _RARE),
        Prior("jump size", "µm", 0.5, 20.0, "log", "slip of a screw's nut, to four backlashes"),
    ),
    "dropped frames": (Prior("dropped frames", "of frames", 0.0, 0.3, "even", _LOST),),
    "lost frames": (Prior("lost frames", "of frames", 0.0, 0.3, "even", _LOST),),
    "bursts": (
        Prior("burst rate", "of frames", 0.003, 0.3, "log", _RARE),
        Prior("burst size", "px", 0.2, 10.0, "log", "up to what the tracker still follows"),
    ),
    "one-axis noise": (
        Prior("noise of y over x", "1", 1 / 30, 30.0, "log", "either axis may be the quiet one"),
    ),
    "backlash": (
        Prior("backlash", "µm", 0.05, 5.0, "log", "a step to twice what such stages are sold with"),
    ),
    "latency jitter": (
        Prior("latency jitter", "ms", 0.3, 15.0, "log", "a desktop's scheduler, idle to busy"),
    ),
    "start off the path": (
        Prior(
            "start off the path", "µm", 1.0, 100.0, "log", "what a step leaves, to a third of it"
        ),
    ),
    "own speeds at 4X": tuple(
        Prior(f"{name} faster at 4X", "times", 0.25, 4.0, "log", "the ratio of the zooms")
        for name in EXPERIMENTS[1:]
    ),
}
#: Those whose disturbance comes a few times a path, so that the path's numbers are chance.
RARE = ("dropped frames", "lost frames", "bursts", "stage jumps", "start off the path")
#: Those of them that a path may show hardly or not at all: a few events, or one start.
RAREST = ("dropped frames", "bursts", "stage jumps", "start off the path")
#: Those that a step shows by chance, too.
RAREST_IN_STEPS = ("latency jitter",)
#: Those whose numbers are left out one by one: the base, and what a first run explained best.
LEADING = ("base", "lost frames", "bursts", "stage jumps", "start off the path")


def priors(model: str) -> tuple[Prior, ...]:
    """Return the unknown numbers of a model.

    Examples
    --------
    >>> [prior.name for prior in priors("stage jumps")][-2:]
    ['jump rate', 'jump size']
    """
    return BASE + MECHANISMS[model]


def values(model: str, normal: NDArray) -> dict[str, NDArray]:
    """Return the numbers by name that stand for standard normal ones, (N, D)."""
    return {prior.name: prior.value(normal[:, k]) for k, prior in enumerate(priors(model))}


def settings(model: str, normal: NDArray, zoom: str, kind: str) -> NDArray[np.float64]:
    """Return the rows of `servo_loop.COLUMNS` for one experiment.

    Parameters
    ----------
    model : str
        One of `MECHANISMS`.
    normal : ndarray, shape (N, D)
        Standard normal numbers, a column each of `priors`.
    zoom, kind : str
        The experiment.

    Returns
    -------
    ndarray, shape (N, 20)
        In the loop's units.
    """
    found = values(model, normal)
    noise = found["image noise"]
    given = {
        "pixel": thesis.effective_pixel(zoom),
        "saturation": found[f"speed limit at {zoom}"],
        "latency": found["latency"] / 1000,
        "latency jitter": found.get("latency jitter", 0.0) / 1000,
        "noise x": noise,
        "noise y": noise * found.get("noise of y over x", 1.0),
        "stage noise": found.get("stage noise", 0.0),
        "jump rate": found.get("jump rate", 0.0),
        "jump size": found.get("jump size", 0.0),
        "lost": found.get("lost frames", 0.0),
        "dropped": found.get("dropped frames", 0.0),
        "burst rate": found.get("burst rate", 0.0),
        "burst size": found.get("burst size", 0.0),
        "backlash": found.get("backlash", 0.0),
        "angle": np.radians(found[f"angle error at {zoom}"]),
        "scale": 1 + found[f"scale error at {zoom}"] / 100,
        "speed": found.get(f"speed on the {kind}", 1.0),
        "size": found["path size"],
        "height": found["sinusoid height"],
        "start": found.get("start off the path", 0.0),
    }
    if zoom == "4X" and f"{kind} faster at 4X" in found:
        given["speed"] = given["speed"] * found[f"{kind} faster at 4X"]
    return np.column_stack([np.broadcast_to(given[name], len(normal)) for name in COLUMNS])


def table() -> pd.DataFrame:
    """Return the priors with their reasons, a row each number."""
    rows = []
    for model, added in {"every": BASE, **MECHANISMS}.items():
        for prior in added:
            ends = f"{prior.low:.3g} to {prior.high:.3g}"
            shape = {"log": "even in the logarithm", "even": "even"}.get(prior.shape)
            if shape is None:
                ends, shape = f"{prior.low:g} ± {prior.high:.3g}", "normal"
            rows.append((model, prior.name, f"{ends} {prior.unit}", shape, prior.reason))
    return pd.DataFrame(rows, columns=["model", "number", "prior", "shape", "reason"])
