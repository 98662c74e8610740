"""What the guides share: the inputs of ``data``, their truth, and the reader's files."""

from __future__ import annotations

import tomllib
import warnings
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tifffile
from numpy.typing import ArrayLike, NDArray

from compendium import ROOT
from microlib._common import PHYSICAL_RANGES, as_physical
from microlib.embryo import ImageEstimate, modulus_from_image
from microlib.io import read_grey
from microlib.membrane import SmallSlopeWarning

#: Where the inputs lie that the guides run on without the reader's own: photographs that others
#: took, and rendered scenes whose truth is known.
REAL, FOLDER = ROOT / "data" / "real", ROOT / "data" / "synthetic"
#: What the results are in if a scale is not known.
UNKNOWN = {
    "spacing": "heights are in frames",
    "pixel_size": "lengths are in px",
    "rate": "times are in frames",
}
#: Unit of each scale.
UNITS = {name: unit for name, (unit, _, _) in PHYSICAL_RANGES.items()} | {
    "rate": "frames/s",
    "box": "px",
    "region": "px",
}
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


@dataclass(frozen=True)
class Input:
    """What a guide works on.

    Attributes
    ----------
    path : str
        The file, folder or pattern.
    data : object
        What was read from it.
    scales : dict
        Each scale by its name, as `microlib` takes it: None for one that is not known, or of which
        each frame of the file has its own; "frame" for a spacing that is not known.
    table : pandas.DataFrame
        The value and the unit of each scale, and where it is from.
    """

    path: str
    data: Any
    scales: dict[str, Any]
    table: pd.DataFrame


def open_input(
    demo: str,
    given: str,
    read: Callable[[str], Any],
    needed: Collection[str] = (),
    **asked: Any,
) -> Input:
    """
    Read a guide's input with its scales, and print what it is and which scales are not known.

    A given scale comes first, then, for a file of `data`, that of its manifest, then that of the
    file.

    Parameters
    ----------
    demo, given : str
        As for `find_input`.
    read : callable
        Reads the path.
    needed : collection of str
        Names of the scales without which there is no result.
    **asked
        The guide's parameters by their names, None for what was not given.

    Returns
    -------
    Input
        What was read, and every scale.

    Raises
    ------
    ValueError
        If a film is one image, a needed scale is neither given nor in the file, or one has a value
        that no microscope has.
    """
    path = find_input(demo, given)
    entry, data = _entry(Path(path)) or {}, read(path)
    print(f"{Path(path).name}, {entry.get('what', 'your own')}")
    if "rate" in asked and len(list(islice(data, 2))) < 2:
        raise ValueError(f"a film must hold two frames or more, got one in {path}")
    found: dict[str, tuple[Any, str]] = dict.fromkeys(asked, (None, "not known"))
    sources = (
        ("the file", _file_scales(data, timed="rate" in asked)),
        ("the demo", entry.get("settings", {})),
    )
    for source, known in (*sources, ("given", asked)):
        found |= {name: (known[name], source) for name in asked if known.get(name) is not None}
    scales: dict[str, Any] = {name: value for name, (value, _) in found.items()}
    unknown = [name for name, value in scales.items() if value is None]
    if missing := [name for name in unknown if name in needed]:
        need = " ".join(f"-p {name} VALUE" for name in missing)
        raise ValueError(
            f"{', '.join(missing)} must be given for {path}, which does not contain "
            f"{'it' if len(missing) == 1 else 'them'}: {need}"
        )
    for name in scales.keys() & PHYSICAL_RANGES.keys() - set(unknown):
        as_physical(name, scales[name], signed=name == "spacing")
    for name in UNKNOWN.keys() & unknown:
        print(f"Note: {name} is neither given nor in the file, so {UNKNOWN[name]}.")
    if (scales.get("spacing") or 0) < 0:
        print("Note: spacing is negative, so each frame is focused lower than the one before.")
    if found.get("spacing", ("", ""))[1] == "not known":
        scales["spacing"] = "frame"  # as `depth_from_focus` calls it
    for name in scales.keys() & {"spacing", "rate"}:
        if found[name][1] == "the file":
            scales[name] = None  # each frame of the file has its own position or time
    rows = {
        name: (value, UNITS.get(name, ""), source)
        for name, (value, source) in found.items()
        if value is not None
    }
    columns = ["value", "unit", "from"]
    table = pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis("scale")
    return Input(path, data, scales, table)


def _file_scales(data: Any, *, timed: bool) -> dict[str, float | None]:
    """Return the scales that a file contains, by the names that the guides give them."""
    positions, time = getattr(data, "positions", None), data.time(1) if timed else None
    return {
        "pixel_size": getattr(data, "pixel_size", None),
        "spacing": None if positions is None else float(np.diff(positions).mean()),
        "rate": 1 / time if time else None,
    }


def compare(
    mine: Input, found: Mapping[str, ArrayLike], allowed: Mapping[str, float]
) -> pd.DataFrame:
    """
    Hold results against the truth of an input of ``data/synthetic``; of other files none is known.

    Parameters
    ----------
    mine : Input
        The input. If its scales are not those of the manifest, nothing is compared.
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
    >>> mine = Input("mine.csv", None, {}, pd.DataFrame())
    >>> compare(mine, {"modulus_MPa": 1.25}, {"modulus_MPa": 0.1})
    The true values of mine.csv are not known, so nothing is compared.
                 values  found
    modulus_MPa       1   1.25
    """
    file = Path(mine.path)
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
        if name in mine.scales and not np.allclose(mine.scales[name], value, rtol=1e-9):
            print(
                f"The true values of {file.name} hold for {name} = {value}, so nothing is compared."
            )
            return table
    truth = _truth(entry)
    if any(value.shape not in ((), truth[name].shape) for name, value in results.items()):
        print(f"The true values of {file.name} hold for all of it, so nothing is compared.")
        return table
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


def rounded(table: pd.DataFrame) -> Any:
    """Return a table that shows four digits of its numbers."""

    def text(one: Any) -> str:
        return f"{one:.{4 if abs(one) < 1e4 else 7}g}" if isinstance(one, float) else str(one)

    return table.style.format(text)


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
