"""Plant faults in what the ledger's checks are fed, and list the checks that no fault turns.

``python -m benchmarks.faults.verdicts`` does it in two ways. First, each recorded number is
replaced: by zero, by its negative, by its double and half, and by the number of another claim. Then
the faults of ``verdicts.toml`` are planted in the inputs of the experiments, one at a time in a
copy of the project, and the notebooks that use them run there. A check is turned where the verdict
is no longer the one that the book states. The notebooks must have been run before.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import Queue

import nbformat

from compendium import ledger

ROOT = Path(__file__).resolve().parents[2]
FAULTS = Path(__file__).with_name("verdicts.toml")
NOT_COPIED = (".*", "__pycache__", "build", "*.egg-info")


@dataclass(frozen=True)
class Fault:
    """A change of one place in the sources, and the notebooks that it should be noticed in."""

    name: str
    file: str
    old: str
    new: str
    notebooks: tuple[str, ...]
    cells: str = ""


def read_faults() -> list[Fault]:
    """Return the planted faults; one whose place is gone, or not alone, is named and left out."""
    entries = tomllib.loads(FAULTS.read_text(encoding="utf-8"))
    faults = []
    for name, entry in entries.items():
        fault = Fault(name, **entry | {"notebooks": tuple(entry["notebooks"])})
        path = ROOT / fault.file
        found = path.read_text(encoding="utf-8").count(fault.old) if path.exists() else 0
        if found != 1:
            print(f"{name}: left out, its place stands {found} times in {fault.file}")
            continue
        faults.append(fault)
    return faults


def replaced(records: dict[str, ledger.Record]) -> dict[str, list[str]]:
    """Return which replacements of its number turn each claim's check."""
    judged = [records[c.id] for c in ledger.claims().values() if c.id in records]
    result = {}
    for k, record in enumerate(judged):
        half = (record.high - record.low) / 2
        others = [r for r in judged if r.unit == record.unit and r.value != record.value]
        other = others[k % len(others)].value if others else judged[k - 1].value
        faults = {
            "zero": 0.0,
            "negative": -record.value,
            "double": 2 * record.value,
            "half": 0.5 * record.value,
            "another's": other,
        }
        claim = ledger.claim(record.id)
        result[record.id] = [
            name
            for name, value in faults.items()
            if ledger.check_stated_verdict(claim, value, value - half, value + half)[1]
        ]
    return result


def copy_project(folder: Path) -> Path:
    shutil.copytree(ROOT, folder, ignore=shutil.ignore_patterns(*NOT_COPIED))
    # Chapter 6 reads the records of the others.
    shutil.copytree(ROOT / "build" / "claims", folder / "build" / "claims")
    return folder


def plant(copies: Queue[Path], fault: Fault) -> tuple[set[str], list[str]]:
    """Return the claims whose check a fault turns, and the notebooks that it stops."""
    folder = copies.get()
    path = folder / fault.file
    sound = path.read_text(encoding="utf-8")
    turned: set[str] = set()
    stopped = []
    whole = {file: file.read_text(encoding="utf-8") for file in (folder / "notebooks").glob("*")}
    try:
        path.write_text(sound.replace(fault.old, fault.new), encoding="utf-8")
        for name in fault.notebooks:
            if fault.cells:
                keep_cells(folder / "notebooks", name, fault.cells)
            run = subprocess.run(
                [sys.executable, "-m", "compendium.run", name, "--force", "--jobs", "1"],
                cwd=folder,
                env=os.environ | {ledger.RECORD_MISMATCHES: "1", "PYTHONPATH": str(folder)},
                capture_output=True,
                check=False,
            )
            turned |= set(objections(folder / "build" / "claims", name))
            if run.returncode:
                stopped.append(name)
    finally:
        for file, text in whole.items():
            file.write_text(text, encoding="utf-8")
        path.write_text(sound, encoding="utf-8")
        copies.put(folder)
    return turned, stopped


def keep_cells(folder: Path, name: str, pattern: str) -> None:
    """Cut a notebook to the cells whose ids begin as the pattern says."""
    (path,) = folder.glob(f"{name}*.ipynb")
    notebook = nbformat.read(path, as_version=4)
    notebook.cells = [cell for cell in notebook.cells if re.match(pattern, cell.id)]
    nbformat.write(notebook, path)


def objections(folder: Path, name: str) -> Iterator[str]:
    for path in folder.glob(f"{name}*.json"):
        for entry in json.loads(path.read_text(encoding="utf-8")):
            if ": " in entry["verdict"]:
                yield entry["id"]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("faults", nargs="*", help="faults to plant; all of them without any")
    parser.add_argument("--jobs", type=int, default=2, help="how many at a time")
    options = parser.parse_args()
    records = ledger.read_records(ROOT / "build" / "claims")
    by_number = replaced(records)
    faults = [f for f in read_faults() if not options.faults or f.name in options.faults]
    with tempfile.TemporaryDirectory() as temporary:
        copies: Queue[Path] = Queue()
        for k in range(options.jobs):
            copies.put(copy_project(Path(temporary) / str(k)))
        with ThreadPoolExecutor(options.jobs) as pool:
            outcomes = list(pool.map(lambda fault: plant(copies, fault), faults))
    for fault, (turned, stopped) in zip(faults, outcomes, strict=True):
        stops = f", stops {', '.join(stopped)}" if stopped else ""
        print(f"{fault.name}: turns {len(turned)} checks{stops}")
        if not turned and not stopped:
            print("  no check notices it")
    turned_by_input = set().union(*(turned for turned, _ in outcomes))
    for kind, found in (
        ("replaced number", {name for name, by in by_number.items() if by}),
        ("input's fault", turned_by_input),
    ):
        idle = sorted(by_number.keys() - found)
        print(f"{len(by_number) - len(idle)} of {len(by_number)} checks are turned by a {kind}")
        for name in idle:
            print(f"  not turned: {name} ({ledger.claim(name).verdict})")
    return 0


if __name__ == "__main__":
    sys.exit(main())
