"""A valid call of every public callable, and what comes back when some arguments are replaced.

Whatever the arguments are, a result comes back or a `ValueError` whose message names an argument.
No other exception, no warning but the documented ones, no changed input, nothing non-finite from
finite values unless it is documented, and no call over its time. `tests/test_arguments.py` tests
this for one argument and for two at a time.
"""

from __future__ import annotations

import atexit
import contextlib
import copy
import inspect
import re
import shutil
import signal
import tempfile
import types
import warnings
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass, replace
from functools import cache
from itertools import zip_longest
from pathlib import Path

import cv2
import numpy as np

from microlib import (
    calibration,
    curvature,
    embryo,
    focus,
    io,
    membrane,
    microscope,
    servoing,
    synthetic,
    tracking,
)
from tests.laws import Row, Units, resolve, tables

#: Processor time for one call, s: waiting for other processes does not count.
LIMIT = 5.0
#: The same for what fits a boundary value problem to an outline, tried by `make fuzz` only.
SLOW = {"membrane.fit_capsule": 60.0}

EGG = {"thickness": 3.0, "probe_half_width": 25.0, "poisson_ratio": 0.5}
INPUTS = {"force": 100.0, "dimple_radius": 200.0, "dimple_depth": 40.0, **EGG}
#: Files are written here and nowhere else: calls are made with it as the current folder.
_KEPT = tempfile.TemporaryDirectory(prefix="fuzz")
atexit.register(_KEPT.cleanup)
FOLDER = Path(_KEPT.name)
GREY = FOLDER / "grey.tif"


def scope() -> microscope.Microscope:
    return microscope.Microscope(
        200000.0, 126000.0, 79380.0, alpha=0.02, beta=0.01, image_size=(300, 260)
    )


@cache
def target() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 255, (64, 72)).astype(np.uint8)


def grid(rows: int = 6, columns: int = 7, pitch: float = 200.0) -> np.ndarray:
    x, y = np.meshgrid(np.arange(columns) - columns // 2, np.arange(rows) - rows // 2)
    return np.column_stack([x.ravel(), y.ravel()]) * pitch + 0.0


@cache
def lines() -> np.ndarray:
    noise = np.random.default_rng(0).normal(0, 2, (40, 120))
    return 190 - 120 * np.exp(-((np.arange(120) % 12 - 5.5) ** 2) / 4) + noise


@cache
def circles() -> np.ndarray:
    return synthetic.render_circles(replace(scope(), alpha=0.0, beta=0.0))


@cache
def charuco() -> np.ndarray:
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    return cv2.aruco.CharucoBoard((4, 3), 3.0, 2.0, markers).generateImage((180, 140))


@cache
def squares() -> np.ndarray:
    return synthetic.render_squares(replace(scope(), alpha=0.0, beta=0.0))


@cache
def egg() -> synthetic.EmbryoImage:  # type: ignore[name-defined]
    return synthetic.embryo_image(
        synthetic.Embryo.pressed(150.0, modulus=1.0), rng=0, pixel_size=7.75, shape=(256, 320)
    )


@cache
def outline():
    return embryo.extract_boundary(egg().image)


@cache
def capsule_outline() -> np.ndarray:
    settings = {**EGG, "modulus": 1.0, "radius": 600.0, "inflation": 1.05}
    state = membrane.indent_capsule(100.0, **settings)
    return np.column_stack([state.r, state.z])[::10]


@cache
def dimple():
    return embryo.fit_dimple(outline(), pixel_size=7.75, probe_half_width=25.0)


@cache
def gripper():
    return synthetic.gripper_scene(0, pixel_size=2.0, shape=(160, 200), reach=40)


@cache
def stack() -> np.ndarray:
    return np.random.default_rng(1).integers(0, 255, (5, 24, 31)).astype(np.uint8)


@cache
def depths() -> focus.FocusResult:
    return focus.depth_from_focus(stack(), np.arange(5.0))


def dome() -> np.ndarray:
    return synthetic.paraboloid((24, 28), 6.0)


def filter_() -> tracking.KalmanFilter:
    return tracking.KalmanFilter([10.0, 20.0], interval=0.04, acceleration=100.0, noise=0.5)


@cache
def bent():
    return curvature.surface_curvature(dome(), 1.0)


def tracker() -> tracking.ESMTracker:
    return tracking.ESMTracker(target(), (16, 16, 32, 32), "translation")


@cache
def calibrated() -> calibration.Calibration:
    return calibration.calibrate(**CALLS["calibration.calibrate"]())


def workstation(**options: object) -> servoing.SimulatedWorkstation:
    scene = gripper()
    settings: dict = {
        "render": lambda feature: scene.frame(feature - scene.home, 0),
        "jacobian": np.eye(2) * 0.3, "stage": servoing.Stage(500.0), "home": scene.home,
        "camera": servoing.Camera(0.04), "rng": 0,
    }  # fmt: skip
    return servoing.SimulatedWorkstation(**settings | options)


def core() -> types.SimpleNamespace:
    return types.SimpleNamespace(
        getXYStageDevice=lambda: "XY",
        getCameraDevice=lambda: "Camera",
        getShutterDevice=lambda: "Shutter",
        getFocusDevice=lambda: "Z",
    )


TRACK = {
    "corners": np.zeros((4, 2)), "lost": False, "reason": "", "correlation": 1.0,
    "homography": np.eye(3), "gain": 1.0, "bias": 0.0, "visible": 1.0, "iterations": 3,
    "covariance": np.eye(2), "confidence": 1.0,
    "hidden": np.zeros((6, 6), bool),
}  # fmt: skip


def stored(value: object) -> dict[str, object]:
    """Return the fields of a dataclass, shallow."""
    return {f.name: getattr(value, f.name) for f in fields(value)}  # type: ignore[arg-type]


#: Valid arguments, made anew for each call, which the table of a room does not have.
CALLS: dict[str, Callable[[], dict[str, object]]] = {
    "calibration.Calibration": lambda: stored(calibrated()),
    "calibration.Calibration.from_json": lambda: {"text": calibrated().to_json()},
    "calibration.Calibration.to_json": lambda: {"self": calibrated()},
    "calibration.Detection": lambda: {
        "points": grid(), "grid": grid().astype(int), "sigma": np.ones(42),
        "group": np.zeros(42, int), "positions": grid(), "side": 0.5, "misfit": 1.0,
        "image_size": (200, 160),
    },
    "calibration.calibrate": lambda: {
        "world": grid(), "image": scope().project(grid()), "focal_length": 126000.0,
        "pixel_size": 9.9, "image_size": (300, 260),
    },
    "calibration.detect_charuco": lambda: {"image": charuco()},
    "calibration.detect_circles": lambda: {"image": circles()},
    "calibration.detect_squares": lambda: {"image": squares()},
    "calibration.detect_pattern": lambda: {"image": squares(), "marks": "squares"},
    "calibration.detect_micrometer": lambda: {"image": lines()},
    "calibration.detection._micrometer.Micrometer.um_per_pixel": lambda: {
        "self": calibration.detect_micrometer(lines()), "division": 10.0,
    },
    "calibration.stage_affine": lambda: {
        "stage": grid(), "image": grid() @ [[1.3, 0.4], [-0.5, 1.6]] + 3.0
    },
    "embryo._boundary.Boundary.without_probe": lambda: {
        "self": outline(), "image": egg().image
    },
    "embryo._dimple.DimpleFit.__call__": lambda: {"self": dimple(), "x": np.linspace(200, 300, 9)},
    "focus.depth_from_focus": lambda: {
        "frames": stack(), "positions": np.arange(5.0), "measure": "sml", "window": 5,
        "region": (0, 0, 20, 20),
    },
    "io.read_frames": lambda: {"frames": stack(), "region": (0, 0, 20, 20)},
    "embryo.dimple_from_outline": lambda: {
        "x": np.arange(60.0), "pixel_size": 3.9,
        "y": 9.0 - 7.0 * np.exp(-(((np.arange(60.0) - 30.0) / 9.0) ** 2))
        - (np.arange(60.0) - 30.0) ** 2 / 300.0,
    },
    "embryo.read_outline": lambda: {"path": table()},
    "io.read_grey": lambda: {"path": written()},
    "io.write_height_tiff": lambda: {
        "path": FOLDER / "fuzz.tif", "height": dome(), "pixel_size": 2.0
    },
    "io.write_ply": lambda: {
        "path": FOLDER / "fuzz.ply", "height": dome(), "pixel_size": 2.0,
        "image": np.zeros((24, 28), np.uint8),
    },
    "servoing.servo": lambda: {
        "jacobian": np.eye(2) * 0.3, "progress": lambda row: None,
    },
    "servoing.MicroManager": lambda: {"core": core()},
    "servoing.SimulatedWorkstation": lambda: {
        "render": lambda feature: target(), "jacobian": np.eye(2) * 0.3,
        "stage": servoing.Stage(500.0), "camera": servoing.Camera(0.04), "rng": 0,
        "home": [10.0, 10.0], "drift": [0.1, 0.2],
    },
    "synthetic._embryo.EmbryoImage.to_pixels": lambda: {"self": egg(), "points": grid() / 10},
    "synthetic._gripper.GripperScene.box": lambda: {
        "self": gripper(), "size": 20, "shift": np.array([3.0, 4.0])
    },
    "synthetic._gripper.GripperScene.frame": lambda: {
        "self": gripper(), "shift": np.array([3.0, 4.0]), "rng": 0
    },
    "tracking.ESMTracker": lambda: {
        "image": target(), "box": (16, 16, 32, 32), "motion": "translation",
        "kalman": filter_(),
    },
    "tracking.KalmanFilter.predict": lambda: {"self": filter_()},
    "tracking.KalmanFilter.update": lambda: {"self": filter_(), "position": [11.0, 21.0]},
    "tracking.track_all": lambda: {"pixel_size": 2.0, "kalman": filter_()},
    "tracking.track_each": lambda: {
        "frames": [target(), target()], "box": (16, 16, 32, 32), "motion": "translation",
        "rate": 25.0, "pixel_size": 2.0, "kalman": filter_(),
    },
}  # fmt: skip

#: Where a result may be NaN or infinite from finite values, as its documentation says.
MAY_BE_UNKNOWN = {
    # undetermined parameters have infinite variances
    "calibration.Calibration.interval", "calibration.calibrate", "calibration.cramer_rao",
    "calibration.Calibration",
    # circles have no side, nor have corners
    "calibration.detect_circles", "calibration.detect_charuco",
    # three moves leave no residual to tell an error by
    "calibration.stage_affine",
    # NaN far from the dimple
    "embryo._dimple.DimpleFit.__call__",
    # the covariance, where that of the curve is not known
    "embryo.dimple_geometry",
    # NaN where the three measures are equal or zero
    "focus.three_point_peak",
    # NaN beyond the fold of the distortion model
    "microscope.distort", "microscope.undistort", "microscope.Microscope.jacobian",
    "microscope.Microscope.project", "microscope.Microscope.project_plane",
    # a region without a known curvature
    "curvature.region_table",
    # the border is NaN
    "curvature.surface_curvature",
    # a direction that the outline leaves open
    "embryo.fit_dimple", "embryo.modulus_from_image", "embryo.force_from_image",
    # terms that coincide have infinite variances
    "embryo.fit_gaussians",
    # unknown pixels are NaN
    "focus.FocusResult", "focus.depth_from_focus",
    # stretches are NaN where the wall is slack
    "membrane.capsule_modulus", "membrane.fit_capsule", "membrane.indent_capsule",
    # NaN where no slope is steep enough
    "membrane.finite_slope_modulus",
    # NaN where a ray misses the plane
    "microscope.Microscope.back_project",
    # an object in the focal plane has its image at infinity
    "optics.image_distance",
    # what a run did not come to
    "servoing.servo",
    # a step that never settles
    "servoing.step_metrics",
    # a lost target has no position
    "tracking.ESMTracker.track",
}  # fmt: skip


def table() -> Path:
    file = FOLDER / "outline.csv"
    file.write_text("x,y\n1,2\n2,3.5\n")
    return file


@cache
def written() -> Path:
    io.write_height_tiff(GREY, np.ones((4, 5)), pixel_size=1.0)
    return GREY


@cache
def names() -> list[str]:
    """Return what is called: each row of a room's table that says how, and what is only here."""
    rows = [name for name, row in tables().items() if isinstance(row, Row) and row.call is None]
    return [*rows, *(name for name in CALLS if name not in rows)]


def valid_call(name: str) -> dict[str, object]:
    """Return arguments of the table of the room and of `CALLS`, and the default of each other."""
    row = tables().get(name)
    given = row.arguments(Units()) if isinstance(row, Row) and row.call is None else {}
    given |= CALLS.get(name, dict)()
    known = inspect.signature(resolve(name)).parameters.values()
    return {p.name: p.default for p in known if p.default is not p.empty} | given


def parameters(name: str, valid: dict[str, object]) -> list[str]:
    """Return the names of the arguments: those that the table has are all that there are."""
    given = inspect.signature(resolve(name)).parameters.values()
    known = [p.name for p in given if p.kind is not p.VAR_KEYWORD]
    return known + [key for key in valid if key not in known]


def wrong_kinds(value: object) -> dict[str, object]:
    """Return what is never right in the place of a valid value, for its kind."""
    if isinstance(value, str):
        return {"text": "another", "3": 3, "bytes": b"x", "[]": []}
    if isinstance(value, (int, float, np.number)):
        masked = np.ma.array(1.0, mask=True)
        return {
            **{"nan": np.nan, "0-d nan": np.array(np.nan), "inf": np.inf, "text": "text"},
            **{"digits": "1", "1j": 1j, "{}": {}, "masked": masked, "ragged": [[1.0], [1.0, 2.0]]},
            **{"True": True, "[1.0]": [1.0], "[]": []},
        }
    if not is_array(value):
        return {"text": "text", "3.0": 3.0, "[]": [], "nan": np.nan}
    array = np.asarray(value)
    plain = array.astype(float)
    with_nan, with_inf = plain.copy(), plain.copy()
    with_nan.flat[-1], with_inf.flat[-1] = np.nan, np.inf
    return {
        **{"with nan": with_nan, "with inf": with_inf, "all nan": plain * np.nan},
        **{"number": 3.0, "one axis more": array[None], "empty": array[:0]},
        **{"text": "text", "text array": array.astype(str), "complex": array.astype(complex)},
        **{"object": object(), "ragged": [[1.0], [1.0, 2.0]]},
        "masked": np.ma.array(array, mask=plain > np.median(plain)),
        "list of masked": [np.ma.array(row, mask=True) for row in np.atleast_1d(array)[:9]],
        **({"flat": array.ravel()} if array.ndim > 1 else {}),
        **({"one column less": array[..., :-1]} if array.shape[-1] == 2 else {}),
    }


def is_checked(value: object) -> bool:
    """Return whether a function checks what is in the place of a valid value.

    It does not check that a flag is True or False, nor that a path, a dictionary, a function or an
    object of this library is one.
    """
    kinds = (int, float, np.number, str, list, tuple, type(None), np.ndarray)
    return isinstance(value, kinds) and not isinstance(value, bool)


def is_array(value: object) -> bool:
    """Return whether a value is an array, or a sequence of numbers or of arrays."""
    numbers = (int, float, np.number, np.ndarray)
    some = isinstance(value, (list, tuple)) and len(value) > 0
    return isinstance(value, np.ndarray) or (some and all(isinstance(v, numbers) for v in value))


def unusual(value: object) -> Iterator[tuple[str, object]]:
    """Yield what may be right in the place of a valid value."""
    # What the library itself gave: frames that were read, results.
    spent = io.read_frames(stack())
    yield f"reader of {len(list(spent))} that were read", spent
    yield from {"depths": depths(), "camera": calibrated()}.items()
    if isinstance(value, (int, float, np.number)) and not isinstance(value, bool):
        for number in (0, -1, 1e3, -1e3, 1e-3, np.uint8(200), np.int8(-100), np.float16(1.5)):
            yield repr(number), number
    if not is_array(value):
        return
    array = np.asarray(value)
    plain = array.astype(np.float64)
    with np.errstate(over="ignore"):
        yield "zeros", np.zeros_like(plain)
        yield "negative", -plain
        yield "all equal", np.full_like(plain, plain.flat[0])
        for scale in (1e-3, 1e3):
            yield f"×{scale:g}", plain * scale
        yield "descending", np.linspace(1e6, 0, plain.size).reshape(plain.shape)
        yield "alternating", np.where(np.arange(plain.size).reshape(plain.shape) % 2, plain, -plain)
        yield "uint8", np.nan_to_num(plain).clip(-1e9, 1e9).astype(np.int64).astype(np.uint8)
    yield "bool", plain > 0
    yield "one less", array[:-1]
    yield "first", array[:1]
    yield "one column less", array[..., :-1]
    yield "reversed", array[::-1]
    yield "no rows", array.reshape(-1, *array.shape[1:])[:0].T
    yield "16-bit floats", plain.clip(-6e4, 6e4).astype(np.float16)
    yield "long doubles", plain.astype(np.longdouble)


def in_another_form(value: object) -> np.ndarray | None:
    """Return the same numbers read-only, strided and in the other byte order."""
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "uif" or value.ndim == 0:
        return None
    wide = np.empty((*value.shape[:-1], 2 * value.shape[-1]), value.dtype.newbyteorder(">"))
    wide[..., ::2] = value
    wide.flags.writeable = False
    return wide[..., ::2]


class Refused(str):
    """What a call says that was refused, in place of its result."""


class OutOfTime(BaseException):
    pass


def _stop(*_: object) -> None:
    raise OutOfTime


def leaves(value: object, depth: int = 0) -> Iterator[np.ndarray]:
    """Yield the numbers and arrays that a value holds."""
    if is_dataclass(value) and not isinstance(value, type):
        value = stored(value)
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, (list, tuple)) and depth < 6:
        for one in value:
            yield from leaves(one, depth + 1)
    elif isinstance(value, (np.ndarray, float, complex, np.number)):
        yield np.asarray(value)


def same(first: object, second: object) -> bool:
    """Return whether two values hold the same bits."""
    pairs = list(zip_longest(leaves(first), leaves(second), fillvalue=np.array("none")))
    return all(a.dtype == b.dtype and a.tobytes() == b.tobytes() for a, b in pairs)


def finite(value: object) -> bool:
    """Return whether every number in a value is finite."""
    return all(one.dtype.kind not in "fc" or np.isfinite(one).all() for one in leaves(value))


def answer(name: str, changed: dict[str, object]) -> tuple[object, str | None]:
    """Call with some arguments replaced; return the result and what is wrong, if anything."""
    given = valid_call(name)
    valid = {key: value for key, value in given.items() if key != "self"}
    call = resolve(name)
    if "self" in given:
        call = getattr(given["self"], name.rsplit(".", 1)[1])
    given = {**valid, **changed}
    kept = {k: v for k, v in given.items() if isinstance(v, (np.ndarray, list, tuple, dict))}
    before = copy.deepcopy(kept)
    limit = SLOW.get(name, LIMIT)
    signal.signal(signal.SIGPROF, _stop)
    signal.setitimer(signal.ITIMER_PROF, limit)
    result, wrong = None, None
    try:
        with contextlib.chdir(FOLDER), warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            warnings.simplefilter("ignore", membrane.SmallSlopeWarning)
            # Documented: a modulus that no membrane has, and what the rest is found without.
            warnings.filterwarnings("ignore", "a modulus of .* is outside the range of membranes")
            warnings.filterwarnings("ignore", "half of height is steeper than")
            warnings.filterwarnings("ignore", "frames .* cannot be registered to each other")
            result = call(**given)
            if inspect.isgenerator(result):
                result = list(result)
    except ValueError as error:
        words = [
            *parameters(name, valid),
            *(k for v in valid.values() if isinstance(v, dict) for k in v),
        ]
        if not re.search(rf"\b({'|'.join(words)})\b", str(error)):
            wrong = f"names no argument: {error}"
        result = Refused(error)
    except OutOfTime:
        wrong = "out of time"
    except (Exception, RecursionError) as error:
        wrong = f"{type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        for path in FOLDER.iterdir():  # what one call writes is not there for the next
            if path != GREY:
                shutil.rmtree(path) if path.is_dir() else path.unlink()
    if not wrong and said:
        wrong = f"warning: {said[0].message}"
    if not wrong and not same(before, kept):
        wrong = "changed its input"
    return result, wrong and wrong[:160]


def fault(name: str, changed: dict[str, object]) -> str | None:
    """Return what is wrong with the answer to a call with some arguments replaced, or None."""
    result, wrong = answer(name, changed)
    if wrong or isinstance(result, Refused) or stores_only(name):
        return wrong
    if name in MAY_BE_UNKNOWN or finite(result):
        return None
    # NaN may come from NaN, in what was replaced or beside it.
    return "not finite" if all(map(finite, (*changed.values(), valid_call(name)))) else None


def stores_only(name: str) -> bool:
    """Return whether a name is a record, which does not look at what it is given."""
    kind = resolve(name)
    return is_dataclass(kind) and not hasattr(kind, "__post_init__")
