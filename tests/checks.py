"""What the tests of several rooms check of a call and of its result.

Each room has the valid calls of its functions, ``CALLS`` in its ``test_public.py``, and says there
how results follow the units of the arguments and what each argument refuses.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import inspect
import json
import pickle
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from microlib._common import FlatResult

#: Chance with which a right uncertainty is rejected, for the seed that a test has.
LEVEL = 1e-3

# --- What arguments refuse ----------------------------------------------------------------------

RAGGED = [[1.0], [1.0, 2.0]]
#: What neither a number nor an array of numbers is.
BROKEN: list[Any] = [
    *(None, True, np.nan, np.array(np.nan), np.inf, "text", "1", 1j, {}, [], RAGGED),
    np.ma.array(1.0, mask=True),
]
NO_NUMBER = [*BROKEN, [1.0]]
NEGATIVE = [*NO_NUMBER, -1]
NOT_POSITIVE = [*NEGATIVE, 0]
#: What is no whole number above zero.
NO_COUNT = [*NOT_POSITIVE, 1.5]
NO_TEXT: list[Any] = [None, "another", 3, b"x", []]


class Wrong(NamedTuple):
    """A value that is refused with a message in which a pattern is found."""

    value: Any
    message: str = ""


def not_real(valid: ArrayLike) -> list[Any]:
    """Return what is refused in place of an array of any shape, in which NaN may be."""
    array = np.asarray(valid)
    rows = np.atleast_1d(array)[:9]
    return [
        *(None, "text", array.astype(str), array.astype(complex), object(), RAGGED),
        np.ma.array(array, mask=np.arange(array.size).reshape(array.shape) % 2 == 0),
        [np.ma.array(row, mask=True) if k == 0 else row for k, row in enumerate(rows)],
        Wrong(array[:0]),
    ]


def not_finite(valid: ArrayLike) -> list[Any]:
    """Return what is refused in place of an array of finite numbers of any shape."""
    with_nan, with_inf = (np.array(valid, float) for _ in range(2))
    with_nan.flat[-1], with_inf.flat[-1] = np.nan, np.inf
    return [*not_real(valid), with_nan, with_inf, with_nan * np.nan]


def no_map(valid: ArrayLike) -> list[Any]:
    """Return what is refused in place of an array of one shape, in which NaN may be."""
    return [*not_real(valid), Wrong(3.0), Wrong(np.asarray(valid)[None])]


def no_array(valid: ArrayLike) -> list[Any]:
    """Return what is refused in place of an array of finite numbers of one shape."""
    return [*not_finite(valid), Wrong(3.0), Wrong(np.asarray(valid)[None])]


def hold_refused(
    function: Callable[..., Any],
    given: dict[str, Any],
    wrong: Mapping[str, list[Any] | Callable[[Any], list[Any]]],
) -> None:
    """Fail unless a valid call is refused with each wrong value in place of an argument.

    The message names the argument, or has the pattern of a `Wrong` value. What is wrong may be a
    function of the valid value; None is allowed where it is the default. An argument that is not
    listed takes one of several words, a whole number or a number above zero, or a finite array.
    """
    known, found = inspect.signature(function).parameters, []
    by_kind = {str: NO_TEXT, int: NO_COUNT, float: NOT_POSITIVE, np.ndarray: no_array}
    by_kind[tuple] = no_array
    usual = {name: by_kind[type(value)] for name, value in given.items() if type(value) in by_kind}
    for name, values in (usual | dict(wrong)).items():
        for value in values(given[name]) if callable(values) else values:
            if value is None and name in known and known[name].default is None:
                continue
            value, message = value if isinstance(value, Wrong) else (value, rf"\b{name}\b")
            try:
                result = function(**given | {name: value})
                if inspect.isgenerator(result):
                    result = list(result)
                found.append(f"{name}={value!r:.60} gives {result!r:.60}")
            except ValueError as error:
                if not re.search(message, str(error)):
                    found.append(f"{name}={value!r:.60}: {error}")
            except Exception as error:
                found.append(f"{name}={value!r:.60}: {type(error).__name__}: {error}")
    assert not found, "\n".join(found)


# --- What every call does -----------------------------------------------------------------------


def hold_call(
    function: Callable[..., Any],
    make: Callable[[], dict[str, Any]],
    *,
    exact: tuple[str, ...] = (),
    undecided: float = 0.0,
    neighbors: bool = True,
) -> None:
    """Fail unless a call keeps its arguments, and its result does not depend on their form.

    The result is the same for the same arguments made again, for arrays that are read-only, strided
    and in the other byte order, and for numbers moved to their neighbors, as rounding moves them,
    but for the arguments that are `exact`. Of a map the share `undecided` may lie at a threshold.
    """

    def call(given: dict[str, Any]) -> Any:
        result = function(**given)
        return list(result) if inspect.isgenerator(result) else result

    given = make()
    before = copy.deepcopy({k: v for k, v in given.items() if isinstance(v, (np.ndarray, list))})
    first = call(given)
    hold_same(before, {name: given[name] for name in before}, within=0.0)
    hold_record(first)
    hold_same(first, call(make()))
    # Images are filtered in single precision, along rows or columns.
    hold_same(first, call({k: in_another_form(v) for k, v in make().items()}), within=1e-4)
    plain = {k: v if k in exact else as_floats(v) for k, v in make().items()}
    rng = np.random.default_rng(0)
    moved = {k: v if k in exact else to_neighbors(v, rng) for k, v in plain.items()}
    if neighbors and (changed := [k for k in plain if moved[k] is not plain[k]]):
        near = call(make() | {k: moved[k] for k in changed})
        here = call(make() | {k: plain[k] for k in changed})
        # Far above 10¹⁵ times a condition number of 10⁸, far below what a result can tell.
        hold_same(here, near, within=1e-6, undecided=undecided)


def in_another_form(value: Any) -> Any:
    """Return the same numbers read-only, strided and in the other byte order."""
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "uif" or value.ndim == 0:
        return value
    wide = np.empty((*value.shape[:-1], 2 * value.shape[-1]), value.dtype.newbyteorder(">"))
    wide[..., ::2] = value
    wide.flags.writeable = False
    return wide[..., ::2]


def as_floats(value: Any) -> Any:
    image = isinstance(value, np.ndarray) and value.dtype == np.uint8 and value.ndim > 1
    return np.asarray(value, np.float64) if image else value


def to_neighbors(value: Any, rng: np.random.Generator) -> Any:
    """Return a value with each number that is not whole moved to one of its neighbors."""
    if isinstance(value, dict):
        return {key: to_neighbors(each, rng) for key, each in value.items()}
    if isinstance(value, float):
        return float(np.nextafter(value, 0.0))
    if not isinstance(value, np.ndarray) or value.dtype != np.float64:
        return value
    there = np.where(rng.random(value.shape) < 0.5, -np.inf, np.inf)
    return np.where(value == 0, value, np.nextafter(value, there))


def hold_record(value: Any) -> None:
    """Fail unless each result has a short repr, survives pickle, and is a row that JSON holds."""
    for found in value if isinstance(value, (tuple, list)) else [value]:
        if not dataclasses.is_dataclass(found) or not type(found).__module__.startswith("microlib"):
            continue
        assert 1 <= len(repr(found).splitlines()) <= 10
        hold_same(found, pickle.loads(pickle.dumps(found)))
        if isinstance(found, FlatResult):
            row = found.to_dict()
            assert json.loads(json.dumps(row, allow_nan=False)) == row
            assert not [name for name in row if re.search(r"_\d", name)]


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
    hold_same(wanted, use(make()))
    hold_same(wanted, use(used))


# --- Comparison of results ----------------------------------------------------------------------


def parts(value: Any) -> dict[Any, Any]:
    """Return what a result, a table, a dictionary or a sequence holds.

    Of a result these are its fields and properties.
    """
    if isinstance(value, (list, tuple)):
        return dict(enumerate(value))
    if isinstance(value, (dict, pd.DataFrame)):
        return {name: value[name] for name in value}
    names = [field.name for field in dataclasses.fields(value)]
    computed = (property, cached_property)
    names += [n for n in dir(type(value)) if isinstance(getattr(type(value), n), computed)]
    return {name: getattr(value, name) for name in names if not name.startswith("_")}


def has_parts(value: Any) -> bool:
    table = isinstance(value, (list, tuple, dict, pd.DataFrame))
    return table or (dataclasses.is_dataclass(value) and not isinstance(value, type))


def hold_same(
    wanted: Any, found: Any, path: str = "", *, within: float = 1e-9, undecided: float = 0.0
) -> None:
    """Fail unless two values, NaN being NaN, are of one kind and the same to rounding.

    `within` is relative to the largest number of an array, or to 10⁻³; of its elements the share
    `undecided` may differ.
    """
    if has_parts(wanted):
        one, other = parts(wanted), parts(found)
        assert type(wanted) is type(found), f"{path} is {found!r:.60} instead of {wanted!r:.60}"
        assert one.keys() == other.keys(), f"{path} has {[*other]} instead of {[*one]}"
        for name, each in one.items():
            hold_same(each, other[name], f"{path}.{name}", within=within, undecided=undecided)
        return
    first, second = np.asarray(wanted), np.asarray(found)
    if first.shape != second.shape or first.dtype.kind != second.dtype.kind:
        wrong = np.ones(1, bool)
    elif first.dtype.kind in "fc":
        size = np.abs(first[np.isfinite(first)]).max(initial=1e-3)
        wrong = ~np.isclose(second, first, rtol=0, atol=within * size, equal_nan=True)
    elif first.dtype.kind == "O" and type(wanted).__eq__ is object.__eq__:
        wrong = np.array([type(wanted) is not type(found)])
    else:
        wrong = first != second
    assert wrong.sum() <= undecided * wrong.size, (
        f"{path} is {found!r:.60} instead of {wanted!r:.60}, in {wrong.sum()} of {wrong.size}"
    )


def hold_scaled(
    found: Any,
    plain: Any,
    factor: Any = 1.0,
    path: str = "",
    *,
    within: float = 1e-9,
    **parts_: Any,
) -> None:
    """Fail unless a result is a factor times the plain one, or what a function makes of that.

    A part that is named has a factor, a function, or factors of its own parts. `within` is relative
    to the largest number of an array.
    """
    assert type(found) is type(plain)
    if has_parts(plain):
        unknown = parts_.keys() - parts(plain).keys()
        assert not unknown, f"{path} has no {unknown}"
        for name, value in parts(plain).items():
            own = parts_.get(name, factor)
            more = own if isinstance(own, dict) else {"factor": own}
            hold_scaled(parts(found)[name], value, path=f"{path}.{name}", within=within, **more)
    elif np.asarray(plain).dtype.kind in "fc":
        wanted = np.asarray(factor(plain) if callable(factor) else np.multiply(plain, factor))
        size = np.abs(wanted[np.isfinite(wanted)]).max(initial=0.0)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=within * size, err_msg=path)
    else:
        np.testing.assert_array_equal(found, plain, err_msg=path)


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
each_view = pytest.mark.parametrize("view", VIEWS, ids=lambda view: view.name)


def follows_view(
    view: View, call: Callable[..., NDArray], *images: NDArray, **tolerance: Any
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
