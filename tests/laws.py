"""The laws that every public name states: units, origins, turns, uncertainty and a second use.

Each room has one table, ``LAWS`` in ``tests/<room>/test_public.py`` (or ``tests/test_<room>.py``
for a room of one file), with a row for every name of `public()`::

    LAWS = {
        "servoing.step_metrics": Law(
            lambda u: {
                "time": u.t0 + np.arange(9.0) ** 1.1 * u.s,
                "position": (u.x0, u.y0) + WAY * u.px,
                "target": (u.x0, u.y0) + (30.0, -20.0) * u.px,
                "band": 0.05,
            },
            {"settling_time": "s", "overshoot": "1", "accuracy": "px", "precision": "px"},
        ),
        "servoing.MicroManager": "it only hands on calls: tests/servoing/test_micromanager.py",
    }

    @pytest.mark.parametrize("name", LAWS)
    def test_outputs_follow_units_and_origins(name):
        hold(name, LAWS[name])

An argument is a number times its unit (``u.um``, ``px``, ``s``, ``uN``, ``grey``, ``MPa``; an angle
has none), counted from an origin where there is one (``t0``, ``x0``, ``y0``, ``x0_um``, ``y0_um``,
``z0``, ``grey0``; they are not 0). Give every argument whose default has a unit. `hold` calls with
the plain units, again with the same arguments, and with all units changed and all origins moved:
no other small power of the units has the same factor. Outputs must follow what the row says: an
expression of units such as ``"px**2/um**2"``, ``"[um, 1]"`` for a last axis,
``"outer([um, 1], [um, 1])"`` for a covariance, ``"s @ t0"`` or ``"px @ [x0, y0]"`` for what moves
with an origin, ``"1"`` for a plain number, ``"="`` for what is equal (text, truth, index). A
dictionary names every field and property of a result and every key of a dictionary or column of a
table; of other objects the attributes that are to be looked at. Columns of `to_dict` and `to_frame`
have the units of the fields that their names begin with. A unit that the arguments do not use stays
as it is: leave ``px`` away for what works on an image, or name it in ``fixed=``.
A tolerance other than rounding is ``within=`` and has a reason beside it.

Further laws are tests beside the table, made of `VIEWS` (a picture mirrored or turned, with its
points), `hold_sigma` and `hold_coverage` (an uncertainty as a number, at three sizes),
`hold_same_as_new` (an object used before).
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import inspect
import pkgutil
import warnings
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy import stats

import microlib
from microlib._common import Tidy
from microlib.membrane import SmallSlopeWarning

#: By how much each unit is changed: no power of two, and no product of few others.
FACTORS = {"um": 1.7, "px": 0.6, "s": 2.3, "uN": 0.45, "grey": 1.37}
#: Each origin's unit, where it is, and by how much it is moved.
ORIGINS = {
    "t0": ("s", 3.7, 11.9), "x0": ("px", 12.0, 31.0), "y0": ("px", -5.0, 17.0),
    "x0_um": ("um", 310.0, -72.0), "y0_um": ("um", -140.0, 95.0), "z0": ("um", 42.0, -130.0),
    "grey0": ("grey", 20.0, 7.0),
}  # fmt: skip
#: Chance with which a right uncertainty is refused, for the seed that a test has.
LEVEL = 1e-3
#: Public, but not called here: a category of warnings, and a picture, as below.
NOT_CALLED = {"membrane.SmallSlopeWarning", "tracking.plot_track"}
#: Methods that take nothing, and pictures, whose tests are tests/test_plots.py.
WITHOUT = {"to_dict", "to_frame", "to_xarray", "plot"}


def public() -> Iterator[str]:
    """Yield the name of every public callable, and of every public method of a public class."""
    for room in (m.name for m in pkgutil.iter_modules(microlib.__path__) if m.name[0] != "_"):
        module = importlib.import_module(f"microlib.{room}")
        for name in module.__all__:
            value = getattr(module, name)
            if not callable(value) or f"{room}.{name}" in NOT_CALLED:
                continue
            yield f"{room}.{name}"
            for method, found in vars(value).items() if inspect.isclass(value) else ():
                function = getattr(found, "__func__", found)
                open_to_all = method == "__call__" or method[0] != "_"
                if inspect.isfunction(function) and open_to_all and method not in WITHOUT:
                    yield f"{room}.{name}.{method}"


def resolve(name: str) -> Callable:
    room, *path = name.split(".")
    value: object = importlib.import_module(f"microlib.{room}")
    for part in path:
        value = getattr(value, part)
    assert callable(value)
    return value


@cache
def tables() -> dict[str, Law | str]:
    """Return the rows of all rooms; a room without a table is missed by its names."""
    found: dict[str, Law | str] = {}
    for room in sorted({name.split(".")[0] for name in public()}):
        package = (Path(__file__).parent / room).is_dir()
        module = f"tests.{room}.test_public" if package else f"tests.test_{room}"
        found |= importlib.import_module(module).LAWS
    return found


class Units:
    """What a number is multiplied by to have a unit; it notes which units and origins are used."""

    def __init__(self, changes: Collection[str] = ()) -> None:
        self._changes, self.used = changes, set[str]()

    def __getattr__(self, name: str) -> float:
        if name == "MPa":
            return self.uN / self.um**2
        self.used.add(name)
        if name in ORIGINS:
            unit, place, way = ORIGINS[name]
            return (place + way * (name in self._changes)) * getattr(self, unit)
        return FACTORS[name] if name in self._changes else 1.0


@dataclass(frozen=True)
class Law:
    """The arguments of a call in units, and the units of what it gives."""

    arguments: Callable[[Any], dict[str, Any]]
    gives: Any
    #: Relative error that the arithmetic may make; of an array, relative to its largest number.
    within: float = 1e-9
    #: Whether a second call with the same arguments gives the same; not where an object goes on.
    again: bool = True
    #: Units that stay as they are though they are used: those of a picture or of a clock's ticks.
    fixed: tuple[str, ...] = ()
    #: What is called in place of the name, for what shows only when an object is used.
    call: Callable[..., Any] | None = None


def invoke(name: str, law: Law, given: dict[str, Any]) -> Any:
    """Call a public function, or a method of the argument `self`."""
    rest = {key: value for key, value in given.items() if key != "self"}
    call = law.call or resolve(name)
    if "self" in given and law.call is None:
        call = getattr(given["self"], name.rsplit(".", 1)[1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SmallSlopeWarning)
        return call(**rest)


def hold(name: str, law: Law | str) -> None:
    """Fail with what does not follow the units and the origins of a row, or a second call."""
    if isinstance(law, str):
        return
    plain = Units()
    given = law.arguments(plain)
    first = invoke(name, law, given)
    found = [*_differences("", first, first, law, law.gives, {})]
    assert not found, f"{name}: {'; '.join(found[:8])}"
    unused = {unit for unit in ("um", "s", "uN") if unit in _words(law.gives)} - plain.used
    assert not unused, f"{name}: the arguments do not use {unused}, which the results have"
    calls = {"called again": (given, {})} if law.again else {}
    changes = {unit: FACTORS[unit] for unit in plain.used & FACTORS.keys() - set(law.fixed)}
    changes |= {origin: ORIGINS[origin][2] for origin in plain.used & ORIGINS.keys()}
    if changes:
        calls["in other units from another origin"] = (law.arguments(Units(changes)), changes)
    for how, (arguments, changed) in calls.items():
        found = [*_differences("", first, invoke(name, law, arguments), law, law.gives, changed)]
        assert not found, f"{name} {how}: {'; '.join(found[:8])}"


def _words(gives: Any) -> set[str]:
    if isinstance(gives, str):
        words = "".join(c if c.isalnum() or c == "_" else " " for c in gives).split()
        return {"uN", "um"} | set(words) if "MPa" in words else set(words)
    parts = gives.values() if isinstance(gives, dict) else gives or ()
    return {word for part in parts for word in _words(part)}


def _value(expression: str, changes: dict[str, float]) -> tuple[Any, Any]:
    """Return by what a result with these units is multiplied and moved."""
    names: dict[str, Any] = dict.fromkeys(FACTORS, 1.0) | dict.fromkeys(ORIGINS, 0.0) | changes
    names |= {name: names[name] * names[unit] for name, (unit, _, _) in ORIGINS.items()}
    names |= {"MPa": names["uN"] / names["um"] ** 2, "rad": 1.0, "outer": np.outer}
    unit, _, origin = expression.partition("@")
    factor, shift = (np.asarray(eval(part or "0", {}, names)) for part in (unit, origin.strip()))
    return factor, shift


def held(value: Any) -> list[str]:
    """Return the names of all that a result holds, a table or a dictionary."""
    if isinstance(value, (dict, pd.DataFrame)):
        return list(value)
    if not dataclasses.is_dataclass(value):
        return []
    own = [f.name for f in dataclasses.fields(value)]
    more = [n for n in dir(type(value)) if isinstance(getattr(type(value), n), property)]
    return [n for n in own + more if not n.startswith("_")]


def _differences(
    path: str, value: Any, got: Any, law: Law, unit: Any, changes: dict[str, float]
) -> Iterator[str]:
    """Yield where `got` is not `value` in changed units and from moved origins."""
    if isinstance(unit, dict) and value is not None:
        names = held(value) or list(unit)
        yield from (f"{path}.{n} has no unit in the table" for n in names if n not in unit)
        for n in (n for n in names if n in unit):
            one, other = (v[n] if hasattr(v, "keys") else getattr(v, n) for v in (value, got))
            yield from _differences(f"{path}.{n}", one, other, law, unit[n], changes)
        if isinstance(value, Tidy):
            yield from _rows(path, value, got, law, unit, changes)
    elif isinstance(value, (list, tuple)) and any(np.ndim(part) for part in value):
        units = unit if isinstance(unit, (list, tuple)) else [unit] * len(value)
        for k, (one, other, own) in enumerate(zip(value, got, units, strict=True)):
            yield from _differences(f"{path}[{k}]", one, other, law, own, changes)
    elif isinstance(unit, (list, tuple)):
        for k, (one, other, own) in enumerate(zip(value, got, unit, strict=True)):
            yield from _differences(f"{path}[{k}]", one, other, law, own, changes)
    elif unit == "=" or unit is None or value is None:
        yield from unlike(value, got, path)
    else:
        yield from _number(path, value, got, law, *_value(unit, changes))


def unlike(
    value: Any, got: Any, path: str = "", *, within: float = 1e-9, undecided: float = 0.0
) -> Iterator[str]:
    """Yield where two values, NaN being NaN, are not of one kind and the same to rounding.

    `within` is relative to the largest number of an array; of its elements the share `undecided`
    may lie at a threshold, where either side is right.
    """
    if isinstance(value, (list, tuple, dict, pd.DataFrame)) or dataclasses.is_dataclass(value):
        one, other = (_parts(v) for v in (value, got))
        if type(value) is not type(got) or one.keys() != other.keys():
            yield f"{path} is {got!r:.60} instead of {value!r:.60}"
            return
        for name, part in one.items():
            found = unlike(part, other[name], f"{path}.{name}", within=within, undecided=undecided)
            yield from found
        return
    first, second = np.asarray(value), np.asarray(got)
    if first.shape != second.shape or first.dtype.kind != second.dtype.kind:
        wrong = np.ones(1, bool)
    elif first.dtype.kind in "fc":
        size = np.abs(first[np.isfinite(first)]).max(initial=1e-3)
        wrong = ~np.isclose(second, first, rtol=0, atol=within * size, equal_nan=True)
    elif first.dtype.kind == "O" and type(value).__eq__ is object.__eq__:
        wrong = np.array([type(value) is not type(got)])
    else:
        wrong = first != second
    if wrong.sum() > undecided * wrong.size:
        yield f"{path} is {got!r:.60} instead of {value!r:.60}, in {wrong.sum()} of {wrong.size}"


def _parts(value: Any) -> dict[Any, Any]:
    if isinstance(value, (list, tuple)):
        return dict(enumerate(value))
    return {n: value[n] if hasattr(value, "keys") else getattr(value, n) for n in held(value)}


def _number(path: str, value: Any, got: Any, law: Law, factor: Any, shift: Any) -> Iterator[str]:
    before, after = (np.asarray(v, complex if np.iscomplexobj(v) else float) for v in (value, got))
    if before.shape != after.shape:
        yield f"{path} has the shape {after.shape} instead of {before.shape}"
        return
    wanted = before * factor + shift
    size = np.abs(wanted[np.isfinite(wanted)]).max(initial=0.0)
    wrong = ~np.isclose(after, wanted, rtol=law.within, atol=law.within * size, equal_nan=True)
    if wrong.any():
        was, now, want = (
            np.atleast_1d(v)[np.atleast_1d(wrong)][0] for v in (before, after, wanted)
        )
        yield f"{path} is {now:.6g} instead of {want:.6g} (it was {was:.6g})"


def _rows(
    path: str, value: Tidy, got: Tidy, law: Law, unit: dict[str, Any], changes: dict[str, float]
) -> Iterator[str]:
    """Yield where the columns of a result's row or table have other units than its fields."""
    for method in ("to_dict", "to_frame"):
        if not hasattr(value, method):
            continue
        one, other = getattr(value, method)(), getattr(got, method)()
        met: dict[str, int] = {}
        for column in one:
            own = _unit_of(column, unit)
            where = f"{path}.{method}()[{column!r}]"
            if own is None:
                yield f"{where} has no unit in the table"
            elif own[1] == "=" or one[column] is None:
                yield from _differences(where, one[column], other[column], law, "=", changes)
            else:
                met[own[0]] = met.get(own[0], -1) + 1
                parts = (np.ravel(part) for part in _value(own[1], changes))
                factor, shift = (part[met[own[0]] % len(part)] for part in parts)
                yield from _number(where, one[column], other[column], law, factor, shift)


def _unit_of(column: str, unit: dict[str, Any]) -> tuple[str, str] | None:
    """Return the field that a column is of, and its unit."""
    fits = [n for n in unit if column == n or column.startswith(f"{n}_")]
    for name in sorted(fits, key=len, reverse=True):
        if isinstance(unit[name], str):
            return name, unit[name]
        if isinstance(unit[name], dict):
            for rest in (column, column[len(name) + 1 :]):
                if (found := _unit_of(rest, unit[name])) is not None:
                    return f"{name}.{found[0]}", found[1]
    return None


# --- Pictures mirrored and turned ---------------------------------------------------------------


@dataclass(frozen=True)
class View:
    """A picture seen otherwise; `matrix` takes (x, y) there, but for the new origin."""

    name: str
    image: Callable[[NDArray], NDArray]
    matrix: NDArray

    def points(self, points: ArrayLike, shape: tuple[int, ...]) -> NDArray:
        """Return where points (x, y) of a picture of a shape (rows, columns, …) are."""
        corners = np.array([[0, 0], [shape[1] - 1, shape[0] - 1]]) @ self.matrix.T
        return np.asarray(points) @ self.matrix.T - corners.min(axis=0)

    def vectors(self, vectors: ArrayLike) -> NDArray:
        return np.asarray(vectors) @ self.matrix.T

    def covariance(self, covariance: ArrayLike) -> NDArray:
        return self.matrix @ np.asarray(covariance) @ self.matrix.T

    def box(self, box: tuple[int, int, int, int], shape: tuple[int, ...]) -> tuple[int, ...]:
        """Return where (x, y, width, height) is."""
        x, y, width, height = box
        ends = self.points([[x, y], [x + width - 1, y + height - 1]], shape).astype(int)
        return (*ends.min(axis=0).tolist(), *(np.ptp(ends, axis=0) + 1).tolist())


VIEWS = [
    View("transposed", lambda a: a.swapaxes(0, 1), np.array([[0, 1], [1, 0]])),
    View("mirrored", lambda a: a[:, ::-1], np.array([[-1, 0], [0, 1]])),
    View("upside down", lambda a: a[::-1], np.array([[1, 0], [0, -1]])),
    View("turned", lambda a: np.rot90(a), np.array([[0, 1], [-1, 0]])),  # anticlockwise
]


# --- Uncertainty --------------------------------------------------------------------------------


def hold_sigma(errors: ArrayLike, sigma: ArrayLike, freedom: float = np.inf) -> None:
    """Fail unless the errors scatter as their stated uncertainties say.

    `errors` are (n,) with standard deviations (n,), or (n, k) with covariances (n, k, k), of n > 50
    independent draws. The mean of q = (error/σ)² is k. Where a sigma has ν `freedom`, residuals
    less parameters, behind it, q/k is F-distributed and q has no variance for few of them: then it
    is the mean of (ν + k) q/(ν + q), a Beta variable, and tells σ best. A sigma that is wrong by
    more than 3.5 √((k + ν + 2)/(2kνn)) is noticed, by 2.5/√n where ν is large: n = 200 for 18 %.
    Errors divided by the root of their covariance are not correlated, each pair to within 1/√n.
    """
    e = np.asarray(errors, float)
    c = np.asarray(sigma, float)
    if e.ndim == 1:
        e, c = e[:, None], c[:, None, None] ** 2
    count, k = e.shape
    z = np.linalg.solve(np.linalg.cholesky(c), e[..., None])[..., 0]
    variance = 2.0 * k
    if np.isfinite(freedom):
        z *= np.sqrt((freedom + k) / (freedom + (z**2).sum(axis=1, keepdims=True)))
        variance *= freedom / (k + freedom + 2)
    q = (z**2).sum(axis=1)
    mean = q.mean() / k
    limit = stats.norm.isf(LEVEL / 2) * np.sqrt(variance / count) / k
    assert abs(mean - 1) < limit, f"(error/σ)² is {mean:.3f} on average, not 1 ± {limit:.3f}"
    together = np.abs((z.T @ z / count)[np.triu_indices(k, 1)])
    limit = stats.norm.isf(LEVEL / max(2 * together.size, 1)) / np.sqrt(count)
    assert (together < limit).all(), (
        f"errors vary together by {together.max():.2f}, not {limit:.2f}"
    )


def hold_coverage(inside: ArrayLike, level: float) -> None:
    """Fail unless as many of the drawn truths lie in their intervals as `level` says."""
    hits = np.asarray(inside, bool)
    low, high = stats.binom.ppf([LEVEL / 2, 1 - LEVEL / 2], hits.size, level)
    assert low <= hits.sum() <= high, f"{hits.sum()} of {hits.size}, not {low:g} to {high:g}"


# --- A second use, and what others show ---------------------------------------------------------


def hold_same_as_new(
    make: Callable[[], Any], use: Callable[[Any], Any], *before: Callable[[Any], Any]
) -> None:
    """Fail unless an object gives in `use` what a new one gives, whatever was done `before`.

    What comes before may be refused; two new objects are compared, too.
    """
    used, wanted = make(), use(make())
    for step in before:
        with contextlib.suppress(ValueError):
            step(used)
    for got in (use(make()), use(used)):
        found = [*unlike(wanted, got)]
        assert not found, "; ".join(found[:8])
