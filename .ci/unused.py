"""List the lines of microlib that no notebook and no command runs: ``make unused``.

The notebooks and the commands run in a copy of the project, under coverage.py. Lines that only
raise an error or warn, by a warning or a note of a command, are not listed, nor are those of an
``except`` clause.
"""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

import coverage
import numpy as np
import tifffile

ROOT = Path(__file__).resolve().parent.parent
#: What people run with the commands, with the smallest files of the project and those of `inputs`.
COMMANDS = (
    "depth data/synthetic/focal_stack.tif --spacing 25 --pixel-size 3.9 --max-uncertainty 5um"
    " -o {out}",
    "depth data/real/beads --register --reduce 2 --workers 2 -o {out}",
    "calibrate data/synthetic/circles.png --pitch 280 --pixel-pitch 9.9"
    " --focal-length 126150 -o {out}",
    "calibrate data/real/chessboard --pitch 25mm -o {out}",
    "calibrate {folder}/10x.tif --marks micrometer --division 10 -o {out}",
    "depth {folder}/stack.ome.tif -o {out}",
    "depth {folder}/imagej.tif -o {out}",
    "track data/synthetic/frames.tif --box 30 40 40 40 --rate 33 -o {out}.csv",
    "track data/synthetic/frames.tif --box 30 40 40 40 --motion affine --video -o {folder}/a.csv",
    "track {folder}/a_look.mp4 --box 30 40 40 40 -o {out}.csv",
    "track {folder}/film.ome.tif --box 30 40 40 40 -o {out}.csv",
    "modulus data/synthetic/outline.csv --force 10 --pixel-size 3.875 --thickness 3"
    " --probe-half-width 25 --poisson-ratio 0.5 --force-uncertainty 0.2 -o {out}.csv",
)
SETTINGS = """[run]
parallel = true
sigterm = true
source = {copy}/microlib
data_file = {folder}/.coverage
"""


def inputs(folder: Path) -> None:
    """Write a stack and a film with metadata as other programs do, and lines of a micrometer."""
    stack = tifffile.imread(ROOT / "data/synthetic/focal_stack.tif")
    sizes = {"PhysicalSizeX": 3.9, "PhysicalSizeY": 3.9, "PhysicalSizeZ": 25.0}
    heights = {"PositionZ": [25.0 * k for k in range(len(stack))]}
    heights["PositionZUnit"] = ["µm"] * len(stack)
    about = {"axes": "ZYX", **sizes, "Plane": heights}
    tifffile.imwrite(folder / "stack.ome.tif", stack, metadata=about)
    about = {"axes": "ZYX", "spacing": 25.0, "unit": "um"}
    tifffile.imwrite(
        folder / "imagej.tif", stack, imagej=True, resolution=(1 / 3.9, 1 / 3.9), metadata=about
    )
    film = tifffile.imread(ROOT / "data/synthetic/frames.tif")
    about = {
        "axes": "TYX",
        "TimeIncrement": 0.03,
        "Plane": {"DeltaT": [0.03 * k for k in range(len(film))]},
    }
    tifffile.imwrite(folder / "film.ome.tif", film, metadata=about)
    lines = np.cos(np.arange(400) * 2 * np.pi / 17.2) > 0.8
    tifffile.imwrite(
        folder / "10x.tif", np.tile(np.where(lines, 60, 200), (90, 1)).astype(np.uint8)
    )


def measure(folder: Path) -> coverage.Coverage:
    """Run the notebooks and the commands in a copy of the project; return what they ran."""
    copy, start = folder / "copy", folder / "start"
    ignored = shutil.ignore_patterns(".git", ".venv*", "build", "__pycache__", ".*_cache")
    shutil.copytree(ROOT, copy, ignore=ignored)
    start.mkdir()
    inputs(folder)
    settings = folder / "settings"
    settings.write_text(SETTINGS.format(copy=copy, folder=folder), encoding="utf-8")
    (start / "sitecustomize.py").write_text("import coverage; coverage.process_startup()\n")
    paths = os.pathsep.join([str(start), str(copy)])
    where = os.environ | {"COVERAGE_PROCESS_START": str(settings), "PYTHONPATH": paths}
    runs = [f"-m microlib {command}" for command in COMMANDS]
    for k, command in enumerate(["-m compendium.run", *runs]):
        words = command.format(out=folder / f"out{k}", folder=folder).split()
        done = subprocess.run([sys.executable, *words], cwd=copy, env=where, check=False)
        if done.returncode:
            print(f"Failed, and its lines may be missing: {command}", file=sys.stderr)
    data = coverage.Coverage(config_file=str(settings))
    data.combine([str(folder)])
    return data


def errors(tree: ast.AST) -> Iterator[int]:
    """Yield the lines that only raise an error or warn, and those of ``except`` clauses."""
    for node in ast.walk(tree):
        warns = ast.unparse(node).startswith(("warnings.warn(", "session.note("))
        if warns or isinstance(node, (ast.ExceptHandler, ast.Raise)):
            yield from lines([node])
        elif isinstance(node, (ast.If, ast.For)):
            for branch in (node.body, node.orelse):
                if branch and isinstance(branch[-1], ast.Raise):
                    yield from lines(branch)


def lines(statements: list) -> Iterator[int]:
    for one in statements:
        yield from range(one.lineno, one.end_lineno + 1)


def main() -> int:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        data = measure(folder)
        total = left = 0
        for path in sorted((folder / "copy" / "microlib").rglob("*.py")):
            _, statements, _, missing, _ = data.analysis2(str(path))
            tree = ast.parse(path.read_text(encoding="utf-8"))
            unused = sorted(set(missing) - set(errors(tree)))
            total, left = total + len(statements), left + len(unused)
            if unused:
                runs = (
                    [line for _, line in group]
                    for _, group in groupby(enumerate(unused), lambda pair: pair[1] - pair[0])
                )
                spans = (f"{r[0]}–{r[-1]}" if len(r) > 1 else f"{r[0]}" for r in runs)
                print(f"{path.relative_to(folder / 'copy')}: {len(unused)}: {', '.join(spans)}")
        print(f"{left} of {total} statements, {100 * left / total:.1f} %, are run by nothing")
    return 0


if __name__ == "__main__":
    sys.exit(main())
