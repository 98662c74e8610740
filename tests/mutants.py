"""Plant one fault at a time in the numerical modules and count those that the tests catch.

``make mutants`` takes a fixed random sample of cosmic-ray's faults in each module (a plus for a
minus, another number, a reversed comparison), runs that module's tests on a copy of the project,
and writes ``tests/mutants.csv``; with modules named, it only prints. The faults that no test
noticed are explained in ``tests/MUTANTS.md``.
"""

from __future__ import annotations

import argparse
import csv
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import Queue

import numpy as np
import parso
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

ROOT = Path(__file__).resolve().parent.parent
RESULT = ROOT / "tests" / "mutants.csv"
# Each module with the tests that should notice a fault in it.
MODULES = {
    "membrane": ["membrane"],
    "finite_slope": ["finite_slope"],
    "modulus_uncertainty": ["membrane"],
    "gaussian_sum": ["gaussian_sum"],
    "loess": ["loess"],
    "curvature": ["curvature"],
    "optics": ["optics"],
    "microscope": ["microscope"],
    "radial_alignment": ["calibration"],
    "camera_jacobian": ["calibration", "microscope"],
    "servoing": ["servoing"],
    "servo_metrics": ["servo_metrics"],
    "kalman": ["kalman"],
    "esm": ["esm", "tracking"],
    "tracking": ["tracking"],
    "depth_correction": ["depth_correction"],
    "ledger": ["ledger"],
    "focus_peaks": ["focus"],
    "_focus_loops": ["focus_measures", "focus"],
    "_focus_doubt": ["focus"],
}
# "X | None" in annotations is never evaluated, a decorator left off is no numerical fault, and the
# operators on variables want to be told names.
IDLE = ("BitOr_", "RemoveDecorator", "ExceptionReplacer", "VariableInserter", "VariableReplacer")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="*", help="modules to test; all of them without any")
    parser.add_argument("--sample", type=int, default=8, help="faults in each module")
    parser.add_argument("--jobs", type=int, default=2, help="how many at a time")
    options = parser.parse_args()
    chosen = options.modules or list(MODULES)
    faults = [(name, *fault) for name in chosen for fault in sample(name, options.sample)]
    with tempfile.TemporaryDirectory() as folder:
        copies: Queue[Path] = Queue()
        for k in range(options.jobs):
            copies.put(copy_project(Path(folder) / str(k)))
        with ThreadPoolExecutor(options.jobs) as pool:
            passing = list(pool.map(lambda name: passes(copies, name), chosen))
            if not all(passing):
                failing = [n for n, fine in zip(chosen, passing, strict=True) if not fine]
                print(f"Without any fault the tests of {', '.join(failing)} fail; mend them first.")
                return 1
            rows = list(pool.map(lambda fault: judge(copies, *fault), faults))
    if not options.modules:
        with RESULT.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["module", "fault", "line", "code", "caught"])
            writer.writerows(rows)
    for row in rows:
        if not row[-1]:
            print("not caught:", *row[:-1])
    for name in chosen:
        mine = [row for row in rows if row[0] == name]
        print(f"{name}: {sum(row[-1] for row in mine)} of {len(mine)} caught")
    caught = sum(row[-1] for row in rows)
    print(f"all: {caught} of {len(rows)} caught, {100 * caught / len(rows):.0f} %")
    return 0


def sample(name: str, size: int) -> Iterator[tuple[str, int]]:
    """Yield the chosen faults of a module: the operator's name and its occurrence."""
    tree = parso.parse((ROOT / "microlib" / f"{name}.py").read_text(encoding="utf-8"))
    every = []
    for operator in sorted(operator_names()):
        if any(word in operator for word in IDLE):
            continue
        visitor = get_operator(operator)()
        count = sum(len(list(visitor.mutation_positions(node))) for node in walk(tree))
        every += [(operator, k) for k in range(count)]
    rng = np.random.default_rng(sum(name.encode()))
    for k in sorted(rng.choice(len(every), min(size, len(every)), replace=False)):
        yield every[k]


def walk(node: parso.tree.NodeOrLeaf) -> Iterator[parso.tree.NodeOrLeaf]:
    yield node
    for child in getattr(node, "children", []):
        yield from walk(child)


def copy_project(folder: Path) -> Path:
    ignore = shutil.ignore_patterns("__pycache__", ".hypothesis")
    for name in ("microlib", "tests", "data", "book", "notebooks"):
        shutil.copytree(ROOT / name, folder / name, ignore=ignore)
    shutil.copy(ROOT / "pyproject.toml", folder)
    return folder


def judge(copies: Queue[Path], name: str, operator: str, occurrence: int) -> list[object]:
    """Plant one fault in a free copy, run the module's tests there, and undo it."""
    folder = copies.get()
    path = folder / "microlib" / f"{name}.py"
    sound = path.read_text(encoding="utf-8")
    faulty = mutate_code(sound, get_operator(operator)(), occurrence)
    lines = zip(sound.splitlines(), faulty.splitlines(), strict=False)
    line, code = next(
        ((n, new.strip()) for n, (old, new) in enumerate(lines, 1) if old != new), (0, "")
    )
    try:
        path.write_text(faulty, encoding="utf-8")
        caught = not run_tests(folder, name)
    finally:
        path.write_text(sound, encoding="utf-8")
        copies.put(folder)
    return [name, f"{operator.removeprefix('core/')}:{occurrence}", line, code, caught]


def passes(copies: Queue[Path], name: str) -> bool:
    """Tell whether a module's tests pass while nothing is wrong with it."""
    folder = copies.get()
    try:
        return run_tests(folder, name)
    finally:
        copies.put(folder)


def run_tests(folder: Path, name: str) -> bool:
    tests = [f"tests/test_{test}.py" for test in MODULES[name]]
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
    environment = os.environ | {"PYTHONPATH": str(folder), "OMP_NUM_THREADS": "1"}
    try:
        run = subprocess.run(
            [*command, *tests, f"microlib/{name}.py"],
            cwd=folder,
            env=environment,
            capture_output=True,
            timeout=120,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False  # a loop without end is noticed, too
    return run.returncode == 0


if __name__ == "__main__":
    sys.exit(main())
