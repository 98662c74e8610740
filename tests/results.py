"""Write down what every public callable returns, and compare it with what it returned before.

``tests/results`` holds a text for each subject: what comes of the valid calls of `tests/fuzz.py`,
and of those with the arguments of `tests/result_variants.py`, which take other ways through the
code; ``tests/compendium/experiments`` holds what the experiments find on small inputs. The texts
hold what is returned, not that it is right, which the tests against known truth say. ``make
results`` writes those anew that changed; the commit that changes one says why.
"""

from __future__ import annotations

import contextlib
import json
import sys
import warnings
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path

import numpy as np

from tests import fuzz
from tests.result_variants import VARIANTS
from tests.snapshots import compare, describe_data, numbers

FOLDER = Path(__file__).parent / "results"
#: Hardly bounded in time; what an extra is needed for; what tells the length of a folder's name.
LEFT_OUT = {*fuzz.SLOW, "focus.depth_to_zarr", "batch.process_files"}
#: On exact points, or at the edge of being lost: rounding decides. Variants are on noisy points.
EXACT = {
    "calibration.Calibration",
    "calibration.Calibration.to_json",
    "calibration.calibrate",
    "calibration.stage_affine",
    "curvature.recognize_part",
    "embryo.fit_gaussians",
    "servoing.servo",
}
#: Other kernels of BLAS, OpenCV and NumPy change what a fit finds by up to half of that.
CLOSE = {"of_itself": 1e-3, "of_largest": 1e-5}
#: Poses of frames whose noise is alike leave brightness open: by up to 4e-4 of the largest.
ROUGH = {"focus.depth_from_focus-registered": {"of_itself": 1e-2, "of_largest": 2e-3}}
#: What the texts are of; other versions round or draw noise otherwise.
PACKAGES = ("numpy", "scipy", "opencv-python-headless", "scikit-image", "numba")


def names() -> list[str]:
    """Return the names of all calls: of a callable, and of its variants after a dash."""
    every = [
        *(name for name in fuzz.CALLS if name not in EXACT),
        *(f"{name}-{label}" for name in VARIANTS for label in VARIANTS[name]),
    ]
    return sorted(name for name in every if name.partition("-")[0] not in LEFT_OUT)


def told(name: str) -> str:
    """Make a call and return what comes of it and what it writes."""
    known, _, label = name.partition("-")
    given = fuzz.CALLS[known]() | (VARIANTS[known][label]() if label else {})
    owner = given.pop("self", None)
    call = fuzz.resolve(known) if owner is None else getattr(owner, known.rpartition(".")[2])
    with contextlib.chdir(fuzz.FOLDER), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            result = call(**given)
            if isinstance(result, str) and result.startswith("{"):
                result = json.loads(result)
            lines = describe_data(owner if result is None else result, "returns")
        except ValueError as error:
            lines = [f"refuses: {error}"]
        for path in sorted(Path().iterdir()):
            if path.name != fuzz.GREY.name:
                # Another tifffile writes the same picture in other bytes.
                content = np.frombuffer(path.read_bytes() * (path.suffix != ".tif"), np.uint8)
                lines.append(numbers(f"writes {path}", content))
                path.unlink()
    return "\n".join(lines) + "\n"


def kept(folder: Path, name: str) -> str:
    """Return what a call returned when its text was written; nothing if it is new."""
    return sections(folder / f"{name.partition('.')[0]}.txt").get(name, "")


def differences(name: str, before: str, text: str) -> list[str]:
    """Return the lines in which two texts of a call differ."""
    return compare(before, text, **ROUGH.get(name, CLOSE))


@cache
def sections(path: Path) -> dict[str, str]:
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    parts = [part.partition("\n") for part in text.split("== ")[1:]]
    return {name: content.strip("\n") + "\n" for name, _, content in parts}


def renew(
    folder: Path,
    told: Callable[[str], str],
    names: Iterable[str],
    differ: Callable[[str, str, str], list[str]] = differences,
) -> None:
    """Write the texts of a folder, one a subject, those as they were that say the same."""
    folder.mkdir(exist_ok=True)
    texts: dict[str, dict[str, str]] = {}
    for name in names:
        text, before = told(name), kept(folder, name)
        same = not differ(name, before, text)
        texts.setdefault(name.partition(".")[0], {})[name] = before if same else text
        if not same:
            print(f"another result: {name}")
    for old in folder.glob("*.txt"):
        if old.stem not in texts:
            old.unlink()
    for room, parts in texts.items():
        content = "\n".join(f"== {name}\n{text}" for name, text in parts.items())
        (folder / f"{room}.txt").write_text(content, encoding="utf-8")


def main() -> int:
    from tests import constants
    from tests.compendium import experiment_cases as experiments

    renew(constants.FOLDER, constants.told, constants.names(), constants.differences)
    renew(FOLDER, told, names())
    renew(experiments.FOLDER, experiments.told, experiments.CASES)
    return 0


if __name__ == "__main__":
    sys.exit(main())
