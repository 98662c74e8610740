"""A valid call of every public callable, and what comes back when some arguments are replaced.

Whatever the arguments are, a result comes back or a `ValueError` whose message names an argument.
No other exception, no warning but the documented ones, no changed input, nothing non-finite from
finite values unless it is documented, and no call over its time. `tests/test_arguments.py` tests
this for one argument and for two at a time.
"""

from __future__ import annotations

import atexit
import copy
import inspect
import re
import signal
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from itertools import count, zip_longest
from pathlib import Path

import cv2
import numpy as np

from microlib import calibration, membrane, synthetic
from tests.laws import Row, Units, resolve, tables

#: Processor time for one call, s: waiting for other processes does not count.
LIMIT = 5.0

#: Files are written here, each call's into a new one.
_KEPT = tempfile.TemporaryDirectory(prefix="fuzz")
atexit.register(_KEPT.cleanup)
FOLDER = Path(_KEPT.name)
_NUMBER = count()
DATA = Path(__file__).parents[1] / "data" / "synthetic"


@cache
def target() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 255, (64, 72)).astype(np.uint8)


@cache
def charuco() -> np.ndarray:
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    return cv2.aruco.CharucoBoard((4, 3), 3.0, 2.0, markers).generateImage((180, 140))


from tests.scenes.embryo import small_egg as egg  # noqa: E402


@cache
def gripper():
    return synthetic.gripper_scene(0, pixel_size=2.0, shape=(160, 200), reach=40)


@cache
def stack() -> np.ndarray:
    return np.random.default_rng(1).integers(0, 255, (5, 24, 31)).astype(np.uint8)


@cache
def calibrated() -> calibration.Calibration:
    return calibration.calibrate(**valid_call("calibration.calibrate"))


#: Arguments, made anew for each call, that the table of the room does not have.
CALLS: dict[str, Callable[[], dict[str, object]]] = {
    "calibration.Calibration.from_json": lambda: {"text": calibrated().to_json()},
    "calibration.Calibration.to_json": lambda: {"self": calibrated()},
    "calibration.detect_charuco": lambda: {"image": charuco()},
    "focus.depth_from_focus": lambda: {
        "frames": stack(), "positions": np.arange(5.0), "measure": "sml", "window": 5,
        "region": (0, 0, 20, 20),
    },
    "io.read_frames": lambda: {"frames": stack(), "region": (0, 0, 20, 20)},
    "io.read_grey": lambda: {"path": DATA / "height_um.tif"},
    "io.write_height_tiff": lambda: {"path": FOLDER / f"{next(_NUMBER)}.tif"},
    "io.write_ply": lambda: {
        "path": FOLDER / f"{next(_NUMBER)}.ply", "image": np.zeros((6, 8), np.uint8)
    },
    "io.write_stl": lambda: {"path": FOLDER / f"{next(_NUMBER)}.stl"},
    "synthetic._embryo.EmbryoImage.to_pixels": lambda: {"self": egg(), "points": np.eye(5, 2)},
    "synthetic._gripper.GripperScene.box": lambda: {
        "self": gripper(), "size": 20, "shift": np.array([3.0, 4.0])
    },
    "synthetic._gripper.GripperScene.frame": lambda: {
        "self": gripper(), "shift": np.array([3.0, 4.0]), "rng": 0
    },
}  # fmt: skip

#: Where a result may be NaN or infinite from finite values, as its documentation says.
MAY_BE_UNKNOWN = {
    # What the data leave open: parameters of a fit, the error of an exact fit, a side of circles.
    "calibration.calibrate",
    "calibration.detect_circles", "calibration.detect_charuco", "calibration.stage_affine",
    "embryo.dimple_geometry", "embryo.fit_dimple", "embryo.modulus_from_image",
    "embryo.fit_gaussians",
    # Beyond the fold of the distortion, beside the plane, in the focal plane, far from the dimple.
    "microscope.distort", "microscope.undistort",
    "microscope.Microscope.project",
    "microscope.Microscope.back_project", "optics.image_distance",
    # Unknown pixels, borders, stretches where the wall is slack, no slope that is steep enough.
    "focus.three_point_peak", "focus.depth_from_focus", "curvature.surface_curvature",
    "curvature.region_table", "membrane.capsule_modulus",
    "membrane.indent_capsule",
    # A run that came to no end, an answer that never settles, a lost target.
    "servoing.servo", "servoing.step_metrics", "tracking.ESMTracker.track",
}  # fmt: skip


def stores_only(name: str) -> bool:
    """Return whether a name is a record, which does not look at what it is given."""
    kind = resolve(name)
    return is_dataclass(kind) and not hasattr(kind, "__post_init__")


@cache
def names() -> list[str]:
    """Return what is called: every row of the tables of the rooms, and what is only in `CALLS`."""
    return [name for name in {**tables(), **CALLS} if not stores_only(name)]


def valid_call(name: str) -> dict[str, object]:
    """Return the default of each argument, or what the table of the room or `CALLS` gives."""
    row, known = tables().get(name), inspect.signature(resolve(name)).parameters
    given = row.arguments(Units()) if isinstance(row, Row) else {}
    if isinstance(row, Row) and row.call is not None and not given.keys() <= known.keys():
        given = {}  # what is called in place of the name has arguments of its own
    default = {p.name: p.default for p in known.values() if p.default is not p.empty}
    return default | given | CALLS.get(name, dict)()


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
    yield "object", object()
    if isinstance(value, (int, float, np.number)) and not isinstance(value, bool):
        for number in (0, -1, 1e3, -1e3, 1e-3, np.uint8(200), np.int8(-100), np.float16(1.5)):
            yield repr(number), number
    if not is_array(value):
        return
    array = np.asarray(value)
    plain = array.astype(np.float64)
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
        value = [getattr(value, field.name) for field in fields(value)]
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
    given = valid_call(name) | changed
    kept = {k: v for k, v in given.items() if isinstance(v, (np.ndarray, list, tuple, dict))}
    before = copy.deepcopy(kept)
    signal.signal(signal.SIGPROF, _stop)
    signal.setitimer(signal.ITIMER_PROF, LIMIT)
    result, wrong = None, None
    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            warnings.simplefilter("ignore", membrane.SmallSlopeWarning)
            # Documented: a modulus that no membrane has, and what the rest is found without.
            warnings.filterwarnings("ignore", "a modulus of .* is outside the range of membranes")
            warnings.filterwarnings("ignore", "half of height is steeper than")
            warnings.filterwarnings("ignore", "frames .* cannot be registered to each other")
            result = resolve(name)(**given)
            if inspect.isgenerator(result):
                result = list(result)
    except ValueError as error:
        words = [*given, *(key for v in given.values() if isinstance(v, dict) for key in v)]
        if not re.search(rf"\b({'|'.join(words)})\b", str(error)):
            wrong = f"names no argument: {error}"
        result = Refused(error)
    except OutOfTime:
        wrong = "out of time"
    except (Exception, RecursionError) as error:
        wrong = f"{type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    if not wrong and said:
        wrong = f"warning: {said[0].message}"
    if not wrong and not same(before, kept):
        wrong = "changed its input"
    return result, wrong and wrong[:160]


def fault(name: str, changed: dict[str, object]) -> str | None:
    """Return what is wrong with the answer to a call with some arguments replaced, or None."""
    result, wrong = answer(name, changed)
    if wrong or isinstance(result, Refused):
        return wrong
    if name in MAY_BE_UNKNOWN or finite(result):
        return None
    # NaN may come from NaN, in what was replaced or beside it.
    return "not finite" if all(map(finite, (*changed.values(), valid_call(name)))) else None
