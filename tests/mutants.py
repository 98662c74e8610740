"""Plant one fault at a time in the library and count those that the tests catch.

``make mutants`` takes a random sample of faults in each package: half of them cosmic-ray's (a plus
for a minus, another number, a reversed comparison), half those of ``tests/planted.py`` (arguments
exchanged, a term or a check forgotten, a wrong unit), as many of each kind as of the others, and at
least two in every module that can hold one (one, if the package has more than a dozen). ``--seed``
draws another sample. It runs that package's tests and the module's examples on a copy of the
project, and writes ``tests/mutants.csv``; with packages named, only their rows change. The faults
that no test noticed are explained in ``tests/MUTANTS.md``.

Packages, modules and tests are found by their folders: a fault in ``microlib/focus/_peaks.py`` is
judged by the quick ``tests/focus/test_parts.py``, ``tests/focus/test_peaks.py`` and the examples in
the module, then by the rest of ``tests/focus``; one in ``microlib/optics.py`` by
``tests/test_optics.py``. What they pass is judged by the tests that go through every package. Its
constants, and what its public callables return, are looked at first, for it takes seconds. The
result says which of the two noticed a fault.
The compendium counts as three: its experiments, its figures, and the rest.
"""

from __future__ import annotations

import argparse
import csv
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from importlib.util import cache_from_source
from itertools import islice, zip_longest
from pathlib import Path
from queue import Queue
from time import perf_counter
from typing import NamedTuple

import numpy as np
import parso
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

from tests.planted import KINDS, Source, edits, plant

ROOT = Path(__file__).resolve().parent.parent
RESULT = ROOT / "tests" / "mutants.csv"
SAMPLE = 24  # faults in each package
LEAST = 2  # faults in each module; one where the package has so many that these are over SAMPLE
# "X | None" in annotations is never evaluated, a decorator left off is no numerical fault, and the
# operators on variables want to be told names.
IDLE = ("BitOr_", "RemoveDecorator", "ExceptionReplacer", "VariableInserter", "VariableReplacer")
OPERATORS = [name for name in sorted(operator_names()) if not any(word in name for word in IDLE)]
LEFT_OUT = {
    "compendium/readme_picture.py": "run by hand, and looked at",
    "compendium/figures/style.py": "how drawings look, which nobody computes with",
}
# Single functions on known numbers, which take no time; what every figure draws and what every
# experiment finds on small inputs, in seconds.
QUICK = ("test_parts.py", "test_figures_drawn.py", "test_experiments_results.py")
PARTS = ("experiments", "figures")  # of the compendium, with tests that are named after them
NOT_COPIED = (".*", "__pycache__", "build", "*.egg-info")
# Tests that go through every package of the library. Of what calls everything public only the
# package's part is run.
THROUGH_ALL = ("test_defaults", "test_measured", "test_refusals", "test_fuzz")
RETURNED = ("test_constants", "test_results")
OWN, LIBRARY, NONE = "by its own tests", "by the library's", "no"


class Fault(NamedTuple):
    """One fault of a module, by the name of its kind and its place among its like."""

    module: Path
    operator: str
    occurrence: int


class Verdict(NamedTuple):
    """What became of a fault: a row of the result."""

    package: str
    module: str
    fault: str
    line: int
    code: str
    caught: str


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("packages", nargs="*", help="such as focus; all of them without any")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--jobs", type=int, default=2, help="copies of the project at a time")
    options = parser.parse_args()
    packages = find_packages()
    if unknown := set(options.packages) - set(packages):
        parser.error(f"no package {', '.join(unknown)}; there are {', '.join(packages)}")
    chosen = options.packages or list(packages)
    faults = {name: sample(name, packages[name], options.seed) for name in chosen}
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(options.jobs) as pool:
        copies: Queue[Path] = Queue()
        for k in range(options.jobs):
            copies.put(copy_project(Path(folder) / str(k)))
        seconds = dict(zip(chosen, pool.map(lambda n: time_tests(copies, n), chosen), strict=True))
        failing = [name for name, spent in seconds.items() if spent is None]
        first = Path(folder) / "0"
        if not run_tests(first, tests_through_all("_common"), first / "numba", 600):
            failing.append("the whole library")
        if failing:
            print(f"Without any fault the tests of {', '.join(failing)} fail; mend them first.")
            return 1
        # Several times what the sound package takes: a loop without end is noticed, too.
        limits = {name: 60 + 3 * (spent or 0) for name, spent in seconds.items()}
        rows: list[Verdict] = []
        for name in chosen:
            found = list(pool.map(partial(judge, copies, name, limits[name]), faults[name]))
            rows += found
            keep(found, packages)  # what is known stays known if this is ended
            print(f"{name}: {count(found)}", flush=True)
    tell(rows, {name: packages[name] for name in chosen}, faults)
    return 0


def keep(rows: list[Verdict], packages: Iterable[str]) -> None:
    """Write the rows in place of those that the result holds of the same packages."""
    new = {row.package for row in rows}
    old: list[list[str]] = []
    if RESULT.exists():
        with RESULT.open(newline="", encoding="utf-8") as file:
            old = [row for row in csv.reader(file) if row[0] in set(packages) - new]
    every = sorted([*old, *rows], key=lambda row: row[0])
    with RESULT.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(Verdict._fields)
        writer.writerows(every)


def tell(
    rows: list[Verdict], packages: dict[str, list[Path]], faults: dict[str, list[Fault]]
) -> None:
    """Print what was not caught, the count of each package, and what was not sampled."""
    for row in rows:
        if row.caught == NONE:
            print(f"not caught: {row.module}:{row.line} {row.fault}: {row.code}")
    print(f"all: {count(rows)}")
    for name, modules in packages.items():
        sampled = {fault.module for fault in faults[name]}
        if bare := [str(m.relative_to(ROOT)) for m in modules if m not in sampled]:
            print(f"not sampled, for no fault can be planted in it: {', '.join(bare)}")
    for path, reason in LEFT_OUT.items():
        print(f"not sampled: {path} ({reason})")


def count(rows: list[Verdict]) -> str:
    own = sum(row.caught == OWN for row in rows)
    caught = own + sum(row.caught == LIBRARY for row in rows)
    share = f"{100 * caught / max(1, len(rows)):.0f} %"
    return f"{caught} of {len(rows)} caught, {share}, {own} of them {OWN}"


def find_packages() -> dict[str, list[Path]]:
    """Return the modules of each package; a subject of one file is a package of its own."""
    packages: dict[str, list[Path]] = {}
    for path in sorted([*ROOT.glob("microlib/**/*.py"), *ROOT.glob("compendium/**/*.py")]):
        inside = path.relative_to(ROOT)
        if not any(inside.is_relative_to(out) for out in LEFT_OUT):
            packages.setdefault(package_of(path), []).append(path)
    return packages


def package_of(path: Path) -> str:
    top, *inner = path.relative_to(ROOT).with_suffix("").parts
    if top == "microlib":
        return top if inner == ["__init__"] else inner[0]
    return inner[0] if inner[0] in PARTS else top


def sample(package: str, modules: list[Path], seed: int) -> list[Fault]:
    """Draw the package's faults: some in each module, and the rest wherever chance has it."""
    every = [fault for path in modules for fault in find_faults(path)]
    # The name makes packages differ; nothing of the code under test chooses the sample.
    rng = np.random.default_rng([seed, *package.encode()])
    drawn = in_turn([every[k] for k in rng.permutation(len(every))])
    least = LEAST if LEAST * len(modules) <= SAMPLE else 1
    chosen: list[Fault] = []
    for path in modules:
        inside = (fault for fault in drawn if fault.module == path and matters(fault))
        chosen += islice(inside, least)
    rest = (fault for fault in drawn if fault not in chosen and matters(fault))
    return sorted([*chosen, *islice(rest, max(0, SAMPLE - len(chosen)))])


def matters(fault: Fault) -> bool:
    """Tell whether a fault changes more than how a drawing looks, which nobody computes with."""
    if package_of(fault.module) != "figures":
        return True
    text = fault.module.read_text(encoding="utf-8")
    return not Source(text).is_look(plant_fault(text, fault))


def in_turn(faults: list[Fault]) -> list[Fault]:
    """Order faults so that every other is cosmic-ray's, and the rest of each kind in turn."""
    foreign = iter([fault for fault in faults if fault.operator not in KINDS])
    kinds = [iter([fault for fault in faults if fault.operator == kind]) for kind in KINDS]
    own = (fault for row in zip_longest(*kinds) for fault in row if fault)
    return [fault for pair in zip_longest(own, foreign) for fault in pair if fault]


def find_faults(module: Path) -> list[Fault]:
    text = module.read_text(encoding="utf-8")
    faults = [Fault(module, kind, k) for kind in KINDS for k in range(len(edits(text, kind)))]
    nodes = [parso.parse(text)]
    for node in nodes:  # grows while it is read
        nodes += getattr(node, "children", [])
    for operator in OPERATORS:
        visitor = get_operator(operator)()
        count = sum(len(list(visitor.mutation_positions(node))) for node in nodes)
        faults += [Fault(module, operator, k) for k in range(count)]
    return faults


def plant_fault(text: str, fault: Fault) -> str:
    if fault.operator in KINDS:
        return plant(text, fault.operator, fault.occurrence)
    return mutate_code(text, get_operator(fault.operator)(), fault.occurrence)


def tests_of(module: Path) -> list[str]:
    """Return what judges a module: what is quick first, and what is likely to notice a fault."""
    examples = str(module.relative_to(ROOT))
    package = package_of(module)
    single = ROOT / "tests" / f"test_{package}.py"
    if single.exists():
        return [examples, str(single.relative_to(ROOT))]
    like = f"test_{module.stem.removeprefix('_')}.py"
    folder = ROOT / "tests" / ("compendium" if package in PARTS else package)
    if package in PARTS:
        like = like.replace("test_", f"test_{package}_")
        files = sorted(folder.glob(f"test_{package}_*.py"))
    else:
        files = [p for p in sorted(folder.rglob("test_*.py")) if p.name.split("_")[1] not in PARTS]
    files.sort(key=lambda path: (path.name not in QUICK, path.name != like))
    names = [str(path.relative_to(ROOT)) for path in files]
    return [*names[:2], examples, *names[2:]]


def tests_through_all(package: str) -> list[str]:
    """Return those tests of the whole library that are about a package; all for `_common`."""
    if package in ("compendium", *PARTS):
        return []
    names = [f"tests/{name}.py" for name in THROUGH_ALL]
    return names if package == "_common" else [*names, "-k", f"not test_fuzz or {package}."]


def copy_project(folder: Path) -> Path:
    return Path(shutil.copytree(ROOT, folder, ignore=shutil.ignore_patterns(*NOT_COPIED)))


def time_tests(copies: Queue[Path], package: str) -> float | None:
    """Return how long a package's tests take while nothing is wrong with it; None if they fail."""
    folder = copies.get()
    modules = find_packages()[package]
    tests = dict.fromkeys(test for module in modules for test in tests_of(module))
    start = perf_counter()
    try:
        passed = run_tests(folder, list(tests), folder / "numba", 600)
    finally:
        copies.put(folder)
    return perf_counter() - start if passed else None


def judge(copies: Queue[Path], package: str, limit: float, fault: Fault) -> Verdict:
    """Plant one fault in a free copy, run the tests of its module there, and undo it."""
    folder = copies.get()
    name = fault.module.relative_to(ROOT)
    path = folder / name
    times = path.stat()
    sound = path.read_text(encoding="utf-8")
    faulty = plant_fault(sound, fault)
    lines = zip(sound.splitlines(), faulty.splitlines(), strict=False)
    line, code = next(
        ((n, new.strip()) for n, (old, new) in enumerate(lines, 1) if old != new), (0, "")
    )
    # What is compiled of the sound modules is kept; a faulty one shall not take its place.
    compiled = folder / ("numba_faulty" if "import numba" in sound else "numba")
    try:
        path.write_text(faulty, encoding="utf-8")
        Path(cache_from_source(str(path))).unlink(missing_ok=True)
        caught, shared = NONE, tests_through_all(package)
        returned = shared and [f"tests/{name}.py" for name in RETURNED]
        if returned and package != "_common":
            returned += ["-k", f"{package}."]
        if returned and not run_tests(folder, returned, compiled, limit):
            caught = LIBRARY
        elif not run_tests(folder, tests_of(fault.module), compiled, limit):
            caught = OWN
        elif shared and not run_tests(folder, shared, compiled, limit):
            caught = LIBRARY
    finally:
        path.write_text(sound, encoding="utf-8")
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
        Path(cache_from_source(str(path))).unlink(missing_ok=True)
        copies.put(folder)
    label = f"{fault.operator.removeprefix('core/')}:{fault.occurrence}"
    return Verdict(package, str(name), label, line, code, caught)


def run_tests(folder: Path, tests: list[str], compiled: Path, limit: float) -> bool:
    command = [sys.executable, "-m", "pytest", "-x", "-q"]
    command += ["-p", "no:cacheprovider", "-p", "no:xdist", "-p", "no:randomly"]
    environment = os.environ | {
        "PYTHONPATH": str(folder),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "NUMBA_CACHE_DIR": str(compiled),
    }
    try:
        run = subprocess.run(
            [*command, *tests],
            cwd=folder,
            env=environment,
            capture_output=True,
            timeout=limit,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False
    # 5: a module without tests or examples, in which nothing can be noticed.
    return run.returncode in (0, 5)


if __name__ == "__main__":
    sys.exit(main())
