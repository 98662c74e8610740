"""What the guides share: the inputs of ``data``, their truth, and the reader's files."""

from __future__ import annotations

import tomllib
import warnings
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tifffile
from numpy.typing import ArrayLike, NDArray

from compendium import ROOT
from microlib.embryo import ImageEstimate, modulus_from_image
from microlib.io import read_grey
from microlib.membrane import SmallSlopeWarning

#: Where the inputs lie that the guides run on without the reader's own: photographs that others
#: took, and rendered scenes whose truth is known.
REAL, FOLDER = ROOT / "data" / "real", ROOT / "data" / "synthetic"
#: Share of the values that must be as near to the truth as is allowed. 5 % of the values may be
#: further away: at the edges of a height map, a pixel sees two heights.
SHARE = 0.95


def find_input(demo: str, given: str = "") -> str:
    """
    Return the path of a guide's input: the one that is given, or the demo's.

    Parameters
    ----------
    demo : str
        Name of a file in ``data/synthetic``, or of a folder in ``data/real``.
    given : str
        Path of a file, or a pattern of several; empty for the demo.

    Returns
    -------
    str
        The path to read.

    Examples
    --------
    >>> find_input("circles.png", "mine.png")
    'mine.png'
    >>> Path(find_input("circles.png")).is_file()
    True
    """
    return given or str(next(each / demo for each in (REAL, FOLDER) if (each / demo).exists()))


def manifest() -> dict[str, dict]:
    """Return what the two ``MANIFEST.toml`` say of each file or folder, by its name."""
    texts = ((each / "MANIFEST.toml").read_text(encoding="utf-8") for each in (REAL, FOLDER))
    return tomllib.loads("\n".join(texts))


def out_folder(given: str, name: str, *, continued: str = "") -> Path:
    """
    Return the folder for a guide's results, and make it; refuse one that holds other files.

    Parameters
    ----------
    given : str
        The reader's own; empty for one in the project's ``build/guides``.
    name : str
        Name of the guide.
    continued : str
        Name of the table by which the guide continues a run that was stopped. A folder that holds
        this table, with its first column `file`, is accepted.

    Returns
    -------
    pathlib.Path
        The folder.

    Raises
    ------
    ValueError
        If the reader's own folder holds files, which the results might replace.
    """
    folder = Path(given or ROOT / "build" / "guides" / name)
    folder.mkdir(parents=True, exist_ok=True)
    # No guide writes hidden files; `compendium.run` may keep the executed notebook here.
    files = sorted(
        path.name for path in folder.iterdir() if not path.name.startswith((".", "07_guide_"))
    )
    if not given or not files:
        return folder
    if continued in files and (folder / continued).read_bytes().startswith(b"file,"):
        return folder
    more = f" and {len(files) - 1} more" if files[1:] else ""
    raise ValueError(
        f"out must be a new or empty folder, got {given}, which holds {files[0]}{more}"
    )


def resolve_scales(
    path: str | PathLike[str],
    given: Mapping[str, Any],
    from_file: Mapping[str, Any] | None = None,
) -> tuple[dict[str, Any], pd.DataFrame]:
    """
    Return each scale of an input as given or as its file contains it, or ask for it by name.

    A given scale comes first, then, for a file of `data`, that of its manifest, then that of the
    file.

    Parameters
    ----------
    path : path-like
        The input, from `find_input`.
    given : mapping
        The guide's parameters, None for what was not given.
    from_file : mapping, optional
        What the file contains of them, None for what it does not.

    Returns
    -------
    values : dict
        Every scale by its name.
    table : pandas.DataFrame
        Its value, and where it is from.

    Raises
    ------
    ValueError
        If a scale is neither given nor in the file.

    Examples
    --------
    >>> values, table = resolve_scales("mine.tif", {"spacing": 25.0, "pixel_size": None},
    ...                                {"pixel_size": 3.9})
    >>> values
    {'spacing': 25.0, 'pixel_size': 3.9}
    >>> table["from"].tolist()
    ['given', 'the file']
    >>> resolve_scales("mine.tif", {"spacing": None})
    Traceback (most recent call last):
    ValueError: spacing must be given for mine.tif, which does not contain it: -p spacing VALUE
    """
    demo = (_entry(Path(path)) or {}).get("settings", {})
    found: dict[str, tuple[Any, str]] = {}
    for source, known in (("the file", from_file or {}), ("the demo", demo), ("given", given)):
        found |= {n: (known[n], source) for n in given if known.get(n) is not None}
    if missing := [name for name in given if name not in found]:
        need = " ".join(f"-p {name} VALUE" for name in missing)
        raise ValueError(
            f"{', '.join(missing)} must be given for {path}, which does not contain "
            f"{'it' if len(missing) == 1 else 'them'}: {need}"
        )
    values, sources = ({name: found[name][k] for name in given} for k in (0, 1))
    table = pd.DataFrame({"value": values, "from": sources}).rename_axis("scale")
    return values, table


def describe(path: str | PathLike[str]) -> str:
    """
    Say in a line what an input is.

    Parameters
    ----------
    path : path-like
        File or pattern, from `find_input`.

    Returns
    -------
    str
        Its name with what the manifest says of it, if it is one of ``data``.

    Examples
    --------
    >>> describe("mine.tif")
    'mine.tif, your own'
    """
    entry = _entry(Path(path))
    return f"{Path(path).name}, {entry['what'] if entry else 'your own'}"


def compare(
    path: str | PathLike[str],
    settings: Mapping[str, ArrayLike],
    found: Mapping[str, ArrayLike],
    allowed: Mapping[str, float],
) -> pd.DataFrame:
    """
    Hold results against the truth of an input of ``data/synthetic``; of other files none is known.

    Parameters
    ----------
    path : path-like
        The input, from `find_input`.
    settings : mapping of str to array_like
        The guide's parameters that the truth depends on. With other values than the manifest's
        nothing is compared.
    found : mapping of str to array_like
        The results, a number or an array each, by the names that the truth has; NaN is unknown.
    allowed : mapping of str to float
        How far 95 of 100 known values of each may be from the truth.

    Returns
    -------
    pandas.DataFrame
        One row a result: how many values are known and their mean and, where there is a truth, its
        mean, the distance within which 95 of 100 values lie, and the allowed one.

    Raises
    ------
    AssertionError
        If a result is further from the truth than allowed, or nowhere known.
    ValueError
        If the names of `found` are not those of the truth.

    Examples
    --------
    >>> compare("mine.csv", {}, {"modulus_MPa": 1.25}, {"modulus_MPa": 0.1})
    The true values of mine.csv are not known, so nothing is compared.
                 values  found
    modulus_MPa       1   1.25
    """
    file = Path(path)
    results = {name: np.asarray(value, dtype=np.float64) for name, value in found.items()}
    results = {name: np.where(np.isfinite(each), each, np.nan) for name, each in results.items()}
    columns = {name: pd.Series(values.ravel()) for name, values in results.items()}
    known = {name: [each.count(), each.mean()] for name, each in columns.items()}
    table = pd.DataFrame(known, index=["values", "found"]).T.astype({"values": int})
    entry = _entry(file)
    if entry is None or "truth" not in entry:
        print(f"The true values of {file.name} are not known, so nothing is compared.")
        return table
    for name, value in entry["settings"].items():
        if name in settings and not np.allclose(settings[name], value, rtol=1e-9):
            print(
                f"The true values of {file.name} hold for {name} = {value}, so nothing is compared."
            )
            return table
    truth = _truth(entry)
    if set(results) != set(truth):
        raise ValueError(f"found must have the names {sorted(truth)}, got {sorted(results)}")
    table["true value"] = [np.nanmean(truth[name]) for name in results]
    distances = (np.abs(value - truth[name]).ravel() for name, value in results.items())
    table["error"] = [pd.Series(distance).quantile(SHARE) for distance in distances]
    table["allowed"] = [float(allowed[name]) for name in results]
    for name, row in table.iterrows():
        if not row["error"] <= row["allowed"]:  # NaN is no agreement
            raise AssertionError(
                f"{file.name}: {name} is {row['error']:.4g} off the truth, "
                f"at most {row['allowed']:.4g} is allowed"
            )
    return table


def modulus_of(path: Path, *, force: float, **settings: Any) -> ImageEstimate:
    """Return the modulus of the embryo in an image file, by `microlib.embryo.modulus_from_image`.

    The function is in a module, because worker processes cannot import from a notebook.
    """
    with warnings.catch_warnings(action="ignore", category=SmallSlopeWarning):
        return modulus_from_image(read_grey(path), force, **settings)


def _entry(file: Path) -> dict | None:
    """Return what the manifest says of a file, if it is one of ``data``."""
    return manifest().get(file.name) if file.resolve().parent in (REAL, FOLDER) else None


def _truth(entry: dict) -> dict[str, NDArray[np.float64]]:
    """Return the numbers of the manifest and the arrays of the file that it names."""
    truth = dict(entry["truth"])
    if "truth_file" in entry:
        file = FOLDER / entry["truth_file"]
        if file.suffix == ".csv":
            table = pd.read_csv(file)
            truth |= {name: table[name].to_numpy() for name in table.columns}
        else:
            truth[file.stem] = tifffile.imread(file)
    return {name: np.asarray(value, dtype=np.float64) for name, value in truth.items()}
