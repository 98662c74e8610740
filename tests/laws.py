"""Laws that public functions keep, each a plain function, and the table that says which hold.

Each package has one table, ``LAWS`` in ``tests/<package>/test_public.py`` (or
``tests/test_<module>.py``), with a row for every name of `public()`::

    LAWS = {
        "servoing.step_metrics": Row(
            lambda u: {
                "time": u.t0 + np.arange(9.0) ** 1.1 * u.s,
                "position": (u.x0, u.y0) + WAY * u.px,
                "target": (u.x0, u.y0) + (30.0, -20.0) * u.px,
                "band": 0.05,
            },
            {"settling_time": s, "overshoot": NUMBER, "accuracy": px, "precision": px},
        ),
        "servoing.MicroManager": TestedBy(test_micromanager.test_a_frame_is_as_tall_as_the_camera),
    }

    @pytest.mark.parametrize(("law", "name"), laws_of(LAWS))
    def test_law_holds(law, name):
        law(name, LAWS[name])

The first part of a row builds the arguments of a call in a system of `Units`: a number times its
unit (``u.um``, ``px``, ``s``, ``uN``, ``grey``, ``MPa``; an angle has none), counted from an origin
where there is one (``t0``, ``x0``, ``y0``, ``x0_um``, ``y0_um``, ``z0``, ``grey0``; none is 0).
Give every argument whose default has a unit. The second part is the unit of the result:

- a `Unit`, such as ``px**2 / um**2``, ``px.counted_from("x0", "y0")`` or `NUMBER`; a list of units
  along the last axis; `covariance` of several units; `SAME` for text, truth values and indices;
- a tuple with one for each part of a tuple; a dictionary with one for each field and property of a
  result, each key of a dictionary or each column of a table.

A unit that the arguments do not use stays as it is: leave ``px`` away for what works on an image,
or name it in ``fixed=``. A tolerance other than rounding is ``within=`` and has a reason beside it.
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
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy import stats

import microlib
from microlib._common import Result
from microlib.membrane import SmallSlopeWarning

#: By how much each unit is changed: no power of two, and no product of few others.
FACTORS = {"um": 1.7, "px": 0.6, "s": 2.3, "uN": 0.45, "grey": 1 / 255}
#: Grey levels are also those of 16 bits.
SIXTEEN_BITS = 257.0
#: Each origin's unit, where it is, and by how much it is moved.
ORIGINS = {
    "t0": ("s", 3.7, 11.9), "x0": ("px", 12.0, 31.0), "y0": ("px", -5.0, 17.0),
    "x0_um": ("um", 310.0, -72.0), "y0_um": ("um", -140.0, 95.0), "z0": ("um", 42.0, -130.0),
    "grey0": ("grey", 20.0, 7.0),
}  # fmt: skip
#: Chance with which a right uncertainty is refused, for the seed that a test has.
LEVEL = 1e-3
#: Public, but not called here: a category of warnings, a picture, as below, and parts of a result
#: that the tests of the result call.
NOT_CALLED = {
    *("membrane.SmallSlopeWarning", "tracking.plot_track"),
    *("embryo.Boundary", "embryo.Probe", "embryo.Rotation"),
}
#: Methods that take nothing, and pictures, whose tests are tests/test_plots.py.
WITHOUT = {"to_dict", "to_frame", "plot"}


def public() -> Iterator[str]:
    """Yield the name of every public callable, and of every public method of a public class.

    But for the class of a result, which functions return.
    """
    for room in (m.name for m in pkgutil.iter_modules(microlib.__path__) if m.name[0] != "_"):
        module = importlib.import_module(f"microlib.{room}")
        for name in module.__all__:
            value = getattr(module, name)
            if not callable(value) or f"{room}.{name}" in NOT_CALLED:
                continue
            if not (inspect.isclass(value) and issubclass(value, Result)):  # nobody makes a result
                yield f"{room}.{name}"
            for method, found in vars(value).items() if inspect.isclass(value) else ():
                function = getattr(found, "__func__", found)
                open_to_all = method == "__call__" or method[0] != "_"
                if inspect.isfunction(function) and open_to_all and method not in WITHOUT:
                    yield f"{room}.{name}.{method}"


def resolve(name: str) -> Any:
    return pkgutil.resolve_name(f"microlib.{name}")


@cache
def tables() -> dict[str, Row | TestedBy]:
    """Return the rows of all packages; a package without a table is missed by its names."""
    found: dict[str, Row | TestedBy] = {}
    for room in sorted({name.split(".")[0] for name in public()}):
        package = (Path(__file__).parent / room).is_dir()
        module = f"tests.{room}.test_public" if package else f"tests.test_{room}"
        found |= getattr(importlib.import_module(module), "LAWS", {})
    return found


# --- Units --------------------------------------------------------------------------------------


class Units:
    """What a number is multiplied by to have a unit, and origins to count it from.

    Both differ from the plain ones where `changed` and `moved` name them.
    """

    def __init__(
        self, changed: Collection[str] = (), moved: Collection[str] = (), **factors: float
    ) -> None:
        self.changes, self.used = {*changed, *moved}, set[str]()
        self.factors = FACTORS | factors

    def __getattr__(self, name: str) -> float:
        if name == "MPa":
            return self.uN / self.um**2
        self.used.add(name)
        if name in ORIGINS:
            unit, place, way = ORIGINS[name]
            return (place + way * (name in self.changes)) * getattr(self, unit)
        return self.factors[name] if name in self.changes else 1.0


@dataclass(frozen=True)
class Unit:
    """A product of powers of the units of `FACTORS`: what a result is measured in.

    A number that moves with an origin names it, or one for each number of the last axis.
    """

    powers: tuple[tuple[str, int], ...] = ()
    origins: tuple[str | None, ...] = ()

    def __mul__(self, other: Unit) -> Unit:
        return Unit(self.powers + other.powers)

    def __pow__(self, power: int) -> Unit:
        return Unit(tuple((name, power * own) for name, own in self.powers))

    def __truediv__(self, other: Unit) -> Unit:
        return self * other**-1

    def __rtruediv__(self, one: int) -> Unit:
        return self**-1

    def counted_from(self, *origins: str | None) -> Unit:
        return Unit(self.powers, origins)

    def factor(self, units: Units) -> float:
        return float(np.prod([getattr(units, name) ** power for name, power in self.powers]))

    def shift(self, units: Units) -> Any:
        plain = Units()
        moved = [
            getattr(units, name) - getattr(plain, name) * self.factor(units) if name else 0.0
            for name in self.origins
        ]
        return moved if len(moved) > 1 else sum(moved)


NUMBER, um, px, s, uN, grey = Unit(), *(Unit(((name, 1),)) for name in FACTORS)
MPa = uN / um**2
#: The unit of text, truth values, indices and None: nothing changes.
SAME = "same"


def covariance(*units: Unit) -> list[list[Unit]]:
    """Return the units of a covariance of numbers with these units."""
    return [[one * other for other in units] for one in units]


def estimate(unit: Any) -> dict[str, Any]:
    """Return the units of an `Estimate` of a quantity with this unit."""
    return dict.fromkeys(("value", "uncertainty", "low", "high", "interval"), unit) | {"unit": SAME}


def converted(value: Any, unit: Any, to: Units, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the name of each part of a result, and the part in other units from other origins."""
    if isinstance(unit, dict) and value is not None:
        names = held(value) or list(unit)
        assert unit.keys() >= set(names), f"{path} has no unit for {set(names) - unit.keys()}"
        for name in names:
            yield from converted(part(value, name), unit[name], to, f"{path}.{name}")
    elif unit is SAME or value is None:
        yield path, value
    elif isinstance(unit, tuple) or (isinstance(value, (list, tuple)) and any(map(np.ndim, value))):
        units = unit if isinstance(unit, tuple) else [unit] * len(value)
        for k, (one, own) in enumerate(zip(value, units, strict=True)):
            yield from converted(one, own, to, f"{path}[{k}]")
    else:
        number = np.asarray(value, complex if np.iscomplexobj(value) else float)
        units = np.array(unit, dtype=object)
        factor = np.vectorize(lambda each: each.factor(to), otypes=[float])(units)
        shift = unit.shift(to) if isinstance(unit, Unit) else 0.0
        yield path, np.asarray(number * factor + shift)


def base_units(unit: Any) -> set[str]:
    """Return the units of `FACTORS` that the unit of a result is made of."""
    if isinstance(unit, Unit):
        return {name for name, _ in unit.powers}
    parts = () if unit is SAME else unit.values() if isinstance(unit, dict) else unit
    return {name for each in parts for name in base_units(each)}


def held(value: Any) -> list[str]:
    """Return the names of all that a result, a table or a dictionary holds.

    Of a result these are its fields and properties, and `to_dict` where it has its own.
    """
    if isinstance(value, (dict, pd.DataFrame)):
        return list(value)
    if not dataclasses.is_dataclass(value):
        return []
    kind = type(value)
    names = [f.name for f in dataclasses.fields(value)]
    names += [n for n in dir(kind) if isinstance(getattr(kind, n), property)]
    row = ["to_dict"] if "to_dict" in vars(kind) else []
    return [n for n in names if not n.startswith("_")] + row


def part(value: Any, name: str) -> Any:
    found = value[name] if hasattr(value, "keys") else getattr(value, name)
    return found() if name == "to_dict" else found


# --- Laws of a call -----------------------------------------------------------------------------


def scales_with_units(name: str, row: Row) -> None:
    """The same quantities in other units give the same quantities."""
    used, _, _ = plain_call(name, row)
    missing = base_units(row.unit) & {"um", "s", "uN"} - used
    assert not missing, f"the result has the unit {missing}, and no argument has it"
    changed = used & FACTORS.keys() - set(row.fixed)
    if changed:
        compare(name, row, Units(changed=changed))


def scales_with_16_bits(name: str, row: Row) -> None:
    """Grey levels of a camera of 16 bits give what those of 8 bits and those up to 1 give."""
    used, _, _ = plain_call(name, row)
    if "grey" in used - {*row.fixed}:
        compare(name, row, Units(changed={"grey"}, grey=SIXTEEN_BITS))


def follows_origins(name: str, row: Row) -> None:
    """Places and times that are counted from elsewhere give the same ones counted from there."""
    used, _, _ = plain_call(name, row)
    if used & ORIGINS.keys():
        compare(name, row, Units(moved=used & ORIGINS.keys()))


def second_call_gives_the_same(name: str, row: Row) -> None:
    """The same arguments give the same result again."""
    compare(name, row, Units())


@dataclass(frozen=True, eq=False)
class Row:
    """A valid call of a public name, the units of its result, and the laws that it keeps."""

    arguments: Callable[[Any], dict[str, Any]]
    unit: Any
    #: Relative error that the arithmetic may make; of an array, relative to its largest number.
    within: float = 1e-9
    laws: tuple[Callable[[str, Row], None], ...] = (
        scales_with_units,
        scales_with_16_bits,
        follows_origins,
        second_call_gives_the_same,
    )
    #: Units that stay as they are though they are used: those of a picture or of a clock's ticks.
    fixed: tuple[str, ...] = ()
    #: What is called in place of the name, for what shows only when an object is used.
    call: Callable[..., Any] | None = None


#: The laws of what goes on with each call, as a filter does.
GOES_ON = (scales_with_units, scales_with_16_bits, follows_origins)


class TestedBy:
    """The tests of what gives no numbers with a unit."""

    __test__ = False

    def __init__(self, *tests: Callable) -> None:
        assert all(test.__name__.startswith("test_") for test in tests)


def laws_of(table: dict[str, Row | TestedBy]) -> list[Any]:
    """Return the laws and the names of a table for which they are to hold, for parametrize."""
    rows = {name: row for name, row in table.items() if isinstance(row, Row)}
    return [
        pytest.param(law, name, id=f"{name}-{law.__name__}")
        for name, row in rows.items()
        for law in row.laws
    ]


def invoke(name: str, row: Row, given: dict[str, Any]) -> Any:
    """Call a public function, a method with the argument `self`, or what a row has for it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SmallSlopeWarning)
        return (row.call or resolve(name))(**given)


@cache
def plain_call(name: str, row: Row) -> tuple[frozenset[str], dict[str, Any], Any]:
    """Return the names of units that a call uses, its arguments and what it gives."""
    units = Units()
    given = row.arguments(units)
    return frozenset(units.used), given, invoke(name, row, given)


def compare(name: str, row: Row, units: Units) -> None:
    """Fail unless a call in some units gives what the plain call gives, converted to them."""
    _, given, first = plain_call(name, row)
    if units.changes:
        given = row.arguments(units)
    wanted = dict(converted(first, row.unit, units, name))
    got = dict(converted(invoke(name, row, given), row.unit, Units(), name))
    assert not (found := [*unlike(wanted, got, within=row.within, zero=0.0)]), found


def unlike(
    value: Any,
    got: Any,
    path: str = "",
    *,
    within: float = 1e-9,
    undecided: float = 0.0,
    zero: float = 1e-3,
) -> Iterator[str]:
    """Yield where two values, NaN being NaN, are not of one kind and the same to rounding.

    `within` is relative to the largest number of an array, and to `zero` where all are smaller; of
    its elements the share `undecided` may lie at a threshold, where either side is right.
    """
    if isinstance(value, (list, tuple, dict, pd.DataFrame)) or dataclasses.is_dataclass(value):
        one, other = (_parts(v) for v in (value, got))
        if type(value) is not type(got) or one.keys() != other.keys():
            yield f"{path} is {got!r:.60} instead of {value!r:.60}"
            return
        for name, own in one.items():
            limits = {"within": within, "undecided": undecided, "zero": zero}
            yield from unlike(own, other[name], f"{path}.{name}", **limits)
        return
    first, second = np.asarray(value), np.asarray(got)
    if first.shape != second.shape or first.dtype.kind != second.dtype.kind:
        wrong = np.ones(1, bool)
    elif first.dtype.kind in "fc":
        size = np.abs(first[np.isfinite(first)]).max(initial=zero)
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
    return {name: part(value, name) for name in held(value)}


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


def follows_view(
    view: View, call: Callable[..., NDArray], *images: NDArray, **tolerance: float
) -> None:
    """Fail unless the map of images that are seen otherwise is the map seen otherwise."""
    wanted = view.image(call(*images))
    got = call(*(np.ascontiguousarray(view.image(image)) for image in images))
    np.testing.assert_allclose(got, wanted, **tolerance)


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
