"""The eight experiments of §5.4 as a compiled loop, with the disturbances that may explain them.

The same loop as `microlib.servoing.simulate` with the optimal controller, to the last digit that is
printed, for many parameters at once: section 5.4's inference needs a hundred million frames.
Lengths in px are of the image, those in µm of the stage.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from compendium import thesis
from compendium.ledger import claim

#: What one experiment needs, a column each. ``angle`` and ``scale`` are the calibration's error;
#: ``speed`` (px/s), ``size`` and ``height`` are those of `section_5_4.PATHS`.
COLUMNS = (
    "pixel",  # µm
    "saturation",  # µm/s
    "latency",  # s
    "latency jitter",  # s, mean of what is added, exponentially distributed, to the latency
    "noise x",  # px
    "noise y",  # px
    "stage noise",  # µm, anew at each exposure
    "jump rate",  # share of the frames before which the stage jumps
    "jump size",  # µm, standard deviation along either axis
    "lost",  # share of the frames without a measurement: no new command, the last one is logged
    "dropped",  # likewise, and nothing is logged
    "burst rate",  # share of the frames with more noise
    "burst size",  # px, its standard deviation along either axis
    "backlash",  # µm
    "angle",  # rad
    "scale",
    "speed",
    "size",
    "height",
    "start",  # µm, standard deviation along either axis of where a path is begun
)
#: Experiments at each zoom; a step's or a path's place here is its number in the loop.
EXPERIMENTS = ("step", "circle", "square", "sinusoid")
#: Columns that an experiment does not read.
IGNORED = {
    "step": ("speed", "size", "height", "start"),
    "circle": ("height",),
    "square": ("height",),
    "sinusoid": (),
}
#: Frames of a step, two seconds and more as in `section_5_4.STEP_PATH`.
STEP_FRAMES = 66
#: Frames of a path at most: mean and deviation of ten seconds are those of the whole turn within
#: a third of the kernel's scale (`tests/compendium/test_experiments_servo_loop.py`).
MOST_FRAMES = 300
#: Shares of the step within which it counts as settled.
BANDS = (0.02, 0.03, 0.05, 0.1)
#: What the words of Table 5.3 may mean, in the order of the loop's results.
STEP_READINGS = tuple(
    product(
        BANDS,
        ("distance within", "both axes within"),
        ("of the distance", "along x"),
        ("at settling", "mean after settling"),
    )
)
#: What the words of Table 5.4 may mean: the error against which reference, and of what of it.
PATH_READINGS = (
    *product(
        ("same frame", "next reference"),
        ("of the distance", "deviation of the vector", "along x"),
    ),
    ("across the path", "of the distance"),
    ("across the path", "deviation with sign"),
)

_STEP = claim("table-5.3/1X/step").value
_INTERVAL, _STAGE_STEP = thesis.FRAME_INTERVAL, thesis.STAGE_STEP
_WEIGHT = thesis.FEATURE_WEIGHT[0]
_CONTROL_X, _CONTROL_Y = thesis.CONTROL_WEIGHT_MICROMETER
_CIRCLE, _SQUARE, _SINUSOID = 40.0, 60.0, (100.0, 20.0)  # px, as in section_5_4.PATHS
_BAND_ARRAY = np.array(BANDS)
#: Commands on their way at most; a latency of two frames with an unlucky jitter needs far fewer.
_QUEUE = 64
#: µm: smaller than anything printed, so that a logarithm exists.
_LEAST = 1e-9


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile, and keep the machine code where a folder allows."""
    try:
        return numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:  # no folder to write to
        return numba.njit(nogil=True, error_model="numpy")(function)


def simulated(
    kind: str, settings: NDArray, repetitions: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Run one experiment for many settings, and measure it by every reading.

    Parameters
    ----------
    kind : str
        One of `EXPERIMENTS`.
    settings : ndarray, shape (N, 20)
        `COLUMNS`, a row each.
    repetitions : int
        Runs of each row, with draws of their own.
    rng : numpy.random.Generator
        Of all draws; two normal numbers a frame come first, as in `microlib.servoing.simulate`.

    Returns
    -------
    ndarray, shape (N, repetitions, readings, numbers)
        For the step, `STEP_READINGS` of settling time (s), accuracy and precision (µm), NaN where
        it never settles; for a path, `PATH_READINGS` of accuracy and precision (µm).
    """
    number = EXPERIMENTS.index(kind)
    readings, numbers = (len(PATH_READINGS), 2) if number else (len(STEP_READINGS), 3)
    found = np.empty((len(settings), repetitions, readings, numbers))
    _simulate_all(number, settings, rng, found)
    return found


def measured_once(kind: str, settings: NDArray, rng: np.random.Generator) -> tuple[NDArray, ...]:
    """Return reference and measured feature of one run, px, a row a frame.

    Parameters
    ----------
    kind, rng
        As in `simulated`.
    settings : ndarray, shape (20,)
        `COLUMNS`.

    Returns
    -------
    reference, measured : ndarray, shape (K, 2)
        As `microlib.servoing.simulate` returns them.
    """
    reference, measured = np.empty((2, MOST_FRAMES, 2))
    frames = _reference(EXPERIMENTS.index(kind), settings, reference)
    _close_loop(kind == "step", settings, reference[:frames], measured, rng)
    return reference[:frames], measured[:frames]


@compiled
def _reference(kind: int, s: NDArray, reference: NDArray) -> int:
    """Write the references of a run, px, as `compendium.experiments.paths` does; count them."""
    speed, size, height = s[16], s[17], s[18]
    if kind == 0:
        reference[:STEP_FRAMES] = _STEP
        return STEP_FRAMES
    radius, side, length = _CIRCLE * size, _SQUARE * size, _SINUSOID[0] * size
    total = 2 * np.pi * radius if kind == 1 else 4 * side if kind == 2 else length
    step = (0.5 * speed if kind == 3 else speed) * _INTERVAL
    frames = min(int(np.ceil(total / step)), MOST_FRAMES)
    for k in range(frames):
        arc = k * step
        if kind == 1:
            reference[k, 0] = radius * (np.cos(arc / radius) - 1.0)
            reference[k, 1] = radius * np.sin(arc / radius)
        elif kind == 2:
            reference[k, 0] = max(0.0, min(arc, side, 3 * side - arc))
            reference[k, 1] = max(0.0, min(arc - side, side, 4 * side - arc))
        else:
            reference[k, 0] = arc
            reference[k, 1] = _SINUSOID[1] * size * height * np.sin(4 * np.pi / length * arc)
    return frames


@compiled
def _close_loop(
    is_step: bool, s: NDArray, reference: NDArray, measured: NDArray, rng: np.random.Generator
) -> None:
    """Write the measured features, px; the events of a frame are those of `COLUMNS`."""
    pixel, limit, latency = s[0], s[1], s[2]
    frames = len(reference)
    begin_x = 0.0 if is_step else reference[0, 0]
    begin_y = 0.0 if is_step else reference[0, 1]
    if s[19] > 0 and not is_step:
        begin_x += s[19] / pixel * rng.standard_normal()
        begin_y += s[19] / pixel * rng.standard_normal()
    # (2.28) for a diagonal Jacobian.
    along = _INTERVAL * _WEIGHT / pixel
    gain_x = along / (along * _INTERVAL / pixel + _CONTROL_X)
    gain_y = along / (along * _INTERVAL / pixel + _CONTROL_Y)
    cosine, sine = s[15] / pixel * np.cos(s[14]), s[15] / pixel * np.sin(s[14])
    due, command = np.empty(_QUEUE), np.empty((_QUEUE, 2))
    first = last = 0  # of the commands on their way, modulo _QUEUE
    x = y = shown_x = shown_y = velocity_x = velocity_y = 0.0
    play, per_step = s[13] / 2, 1 / _STAGE_STEP
    for k in range(frames):
        seen_x, seen_y = s[4] * rng.standard_normal(), s[5] * rng.standard_normal()
        if s[7] > 0 and rng.random() < s[7]:
            x += s[8] * rng.standard_normal()
            y += s[8] * rng.standard_normal()
        shown_x = min(max(shown_x, x - play), x + play)
        shown_y = min(max(shown_y, y - play), y + play)
        at_x = np.rint(shown_x * per_step) * _STAGE_STEP
        at_y = np.rint(shown_y * per_step) * _STAGE_STEP
        if s[6] > 0:
            at_x += s[6] * rng.standard_normal()
            at_y += s[6] * rng.standard_normal()
        if s[11] > 0 and rng.random() < s[11]:
            seen_x += s[12] * rng.standard_normal()
            seen_y += s[12] * rng.standard_normal()
        if s[9] > 0 and k > 0 and rng.random() < s[9]:
            measured[k] = measured[k - 1]
        elif s[10] > 0 and k > 0 and rng.random() < s[10]:
            measured[k] = np.nan
        else:
            measured[k, 0] = begin_x + cosine * at_x - sine * at_y + seen_x
            measured[k, 1] = begin_y + sine * at_x + cosine * at_y + seen_y
            ahead = min(k + 1, frames - 1)
            late = latency
            if s[3] > 0:
                late -= s[3] * np.log(1.0 - rng.random())
            if last > first:  # commands stay in their order
                late = max(late, due[(last - 1) % _QUEUE])
            place = last % _QUEUE
            due[place] = late
            wanted = gain_x * (reference[ahead, 0] - measured[k, 0])
            command[place, 0] = min(max(wanted, -limit), limit)
            wanted = gain_y * (reference[ahead, 1] - measured[k, 1])
            command[place, 1] = min(max(wanted, -limit), limit)
            last += 1
            if last - first == _QUEUE:  # the oldest is dropped
                first += 1
        now = 0.0
        while first < last and due[first % _QUEUE] < _INTERVAL:
            place = first % _QUEUE
            x += velocity_x * (due[place] - now)
            y += velocity_y * (due[place] - now)
            velocity_x, velocity_y = command[place]
            now = due[place]
            first += 1
        x += velocity_x * (_INTERVAL - now)
        y += velocity_y * (_INTERVAL - now)
        for j in range(first, last):
            due[j % _QUEUE] -= _INTERVAL


@compiled
def _simulate_all(kind: int, settings: NDArray, rng: np.random.Generator, found: NDArray) -> None:
    """Fill `found`, the result of `simulated`."""
    reference, measured = np.empty((MOST_FRAMES, 2)), np.empty((MOST_FRAMES, 2))
    repetitions = found.shape[1]
    for i in range(len(settings)):
        frames = _reference(kind, settings[i], reference)
        for r in range(repetitions):
            _close_loop(kind == 0, settings[i], reference[:frames], measured, rng)
            if kind == 0:
                # The step is commanded at any time of the frame before the first exposure.
                ahead = (r + rng.random()) / repetitions * _INTERVAL
                _measure_step(measured[:frames], settings[i, 0], ahead, found[i, r])
            else:
                _measure_path(measured[:frames], reference, settings[i, 0], found[i, r])


@compiled
def _measure_step(measured: NDArray, pixel: float, ahead: float, found: NDArray) -> None:
    """Measure a step by each of `STEP_READINGS`."""
    frames, wanted = len(measured), np.sqrt(2.0) * _STEP
    # Sums from each sample to the last: of the distance and of the error along x, squares, count.
    sums = np.zeros((frames + 1, 5))
    largest = np.zeros((frames + 1, 2))
    errors = np.empty((frames, 2))
    for k in range(frames - 1, -1, -1):
        sums[k], largest[k], errors[k] = sums[k + 1], largest[k + 1], np.nan
        if np.isnan(measured[k, 0]):
            continue
        sums[k, 4] += 1
        dx, dy = abs(measured[k, 0] - _STEP), abs(measured[k, 1] - _STEP)
        errors[k, 0], errors[k, 1] = np.sqrt(dx * dx + dy * dy), dx
        for axis in range(2):
            sums[k, axis] += errors[k, axis]
            sums[k, 2 + axis] += errors[k, axis] ** 2
        largest[k, 0] = max(largest[k + 1, 0], errors[k, 0] / wanted)
        largest[k, 1] = max(largest[k + 1, 1], dx / _STEP, dy / _STEP)
    reading = 0
    for band in _BAND_ARRAY:
        for within in range(2):
            settled = 0
            while settled < frames and (
                largest[settled, within] > band or np.isnan(errors[settled, 0])
            ):
                settled += 1
            count = sums[settled, 4]
            for axis in range(2):
                mean = sums[settled, axis] / count if count else np.nan
                variance = sums[settled, 2 + axis] / count - mean**2 if count else np.nan
                for after in range(2):
                    if count:
                        error = mean if after else errors[settled, axis]
                        found[reading, 0] = settled * _INTERVAL + ahead
                        found[reading, 1] = max(error * pixel, _LEAST)
                        found[reading, 2] = max(np.sqrt(max(variance, 0.0)) * pixel, _LEAST)
                    else:
                        found[reading] = np.nan
                    reading += 1


@compiled
def _measure_path(measured: NDArray, reference: NDArray, pixel: float, found: NDArray) -> None:
    """Measure a path by each of `PATH_READINGS`."""
    frames = len(measured)
    sums = np.zeros((3, 7))  # of x, y, x², y², distance, |x| and one, against each reference
    for k in range(frames):
        if np.isnan(measured[k, 0]):
            continue
        ahead = min(k + 1, frames - 1)
        before = max(ahead - 1, 0)
        run_x = reference[ahead, 0] - reference[before, 0]
        run_y = reference[ahead, 1] - reference[before, 1]
        run = np.sqrt(run_x * run_x + run_y * run_y)
        for lead in range(3):
            if lead == 1 and k == frames - 1:
                continue  # the last sample has no next reference
            aim = ahead if lead == 1 else k
            dx, dy = measured[k, 0] - reference[aim, 0], measured[k, 1] - reference[aim, 1]
            if lead == 2:  # the error across the path, with sign
                dx, dy = (dy * run_x - dx * run_y) / run, 0.0
            sums[lead, 0] += dx
            sums[lead, 1] += dy
            sums[lead, 2] += dx * dx
            sums[lead, 3] += dy * dy
            sums[lead, 4] += np.sqrt(dx * dx + dy * dy)
            sums[lead, 5] += abs(dx)
            sums[lead, 6] += 1
    reading = 0
    for lead in range(3):
        total = sums[lead] / sums[lead, 6]
        square = total[2] + total[3]
        for kind in range(3):
            if lead == 2 and kind == 2:
                continue
            mean = total[5] if kind == 2 else total[4]
            if kind == 0:
                variance = square - total[4] ** 2
            elif kind == 1:
                variance = square - total[0] ** 2 - total[1] ** 2
            else:
                variance = total[2] - total[5] ** 2
            found[reading, 0] = max(mean * pixel, _LEAST)
            found[reading, 1] = max(np.sqrt(max(variance, 0.0)) * pixel, _LEAST)
            reading += 1
