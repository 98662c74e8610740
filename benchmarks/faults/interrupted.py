"""Interrupt and kill runs at random moments, and see that the next run is complete and right.

``python -m benchmarks.faults.interrupted`` takes each guide on its own input, one chapter, and
`make book` in a copy of the project, each 20 times: half of the runs get Ctrl-C, half are killed.
After each no process may be left, no file may stand under its final name unless it is whole, and
the next run must leave the same bytes as one that nothing disturbed. With names, only those are
taken: a guide as ``calibration``, a chapter as ``04``, or ``book``, which takes long.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import monotonic, sleep

import numpy as np

from benchmarks.faults.planted import NOT_COPIED, ROOT

CHAPTER = "04"
#: s for workers and kernels to see that their parent is gone; kernels look once a second.
GRACE = 5.0
LONGEST = 1800.0  # s
MARK = "COMPENDIUM_FAULTS"


@dataclass(frozen=True)
class Target:
    """A command, run in a copy of the project, and the folders that it leaves files in."""

    tree: Path
    command: tuple[str, ...]
    folders: tuple[Path, ...]

    def files(self) -> dict[Path, bytes]:
        """Return what stands under a final name, without the times that a run took."""
        found = {}
        for folder in self.folders:
            for path in folder.rglob("*"):
                if path.is_file() and not unfinished(path.relative_to(folder)):
                    found[path] = stable(path)
        return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "names", nargs="*", help="guides, chapters or book; all of them without any"
    )
    parser.add_argument("--times", type=int, default=20, help="how often each is disturbed")
    options = parser.parse_args()
    guides = sorted(p.stem.removeprefix("07_guide_") for p in ROOT.glob("notebooks/07_guide_*"))
    faults = 0
    for name in options.names or [*guides, CHAPTER, "book"]:
        with tempfile.TemporaryDirectory() as folder:
            tree = Path(folder) / "tree"
            shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(*NOT_COPIED))
            (tree / ".venv").symlink_to(Path(sys.prefix))
            found = disturb(
                target(name, tree), np.random.default_rng(sum(name.encode())), options.times
            )
            for fault in found:
                print(f"{name}: {fault}")
            print(f"{name}: {options.times} times, {len(found)} faults", flush=True)
            faults += len(found)
    return 1 if faults else 0


def target(name: str, tree: Path) -> Target:
    run = (sys.executable, "-m", "compendium.run")
    build = tree / "build"
    if name == "book":
        parts = tuple(build / part for part in ("notebooks", "claims", "figures"))
        make = ("make", "--old-file=.venv/.installed", "book")  # the environment is there
        return Target(tree, make, (*parts, build / "html"))
    if name[0].isdigit():
        return Target(tree, (*run, name, "--force"), (build,))
    options = ("-p", "out", "kept", "--output", "mine")
    return Target(tree, (*run, f"07_guide_{name}", *options), (tree / "kept", tree / "mine"))


def unfinished(path: Path) -> bool:
    """Tell whether a file lies where nobody takes it for a result."""
    return path.name.startswith(".") or path.parts[0] in ("running", "failed")


def stable(path: Path) -> bytes:
    """Return a file's content; only whether it is whole if it says how long a run took."""
    content = path.read_bytes()
    ends = {".html": b"</html>", "searchindex.js": b")"}
    if end := ends.get(path.name) or ends.get(path.suffix):
        return b"whole" if content.rstrip().endswith(end) else b"cut off"
    if path.parent.name == "status":
        status = json.loads(content)
        status.pop("seconds")
        return json.dumps(status).encode()
    return content


def disturb(one: Target, rng: np.random.Generator, times: int) -> list[str]:
    """Run a target once undisturbed, then as often as told with a signal at a random moment."""
    begun = monotonic()
    if (status := finish(one)) != 0:
        return [f"the undisturbed run ends with {status}"]
    length, right = monotonic() - begun, one.files()
    statuses = sorted((one.tree / "build" / "status").glob("*.json"))
    if one.command[0] == "make":  # from here on one notebook is run, and the book is rendered
        quick = min(statuses, key=seconds)
        quick.unlink()
        begun = monotonic()
        finish(one)
        length = monotonic() - begun - seconds(quick)
    found = []
    for turn in range(times):
        how = (signal.SIGINT, signal.SIGKILL)[turn % 2]
        lasts = length
        if one.command[0] == "make":  # or there would be nothing to run
            due = statuses[rng.integers(len(statuses))]
            lasts += seconds(due)
            due.unlink()
        moment = float(rng.uniform(0, lasts))
        label = f"{how.name} after {moment:.2f} s"
        found += [f"{label}: {fault}" for fault in one_turn(one, how, moment, right)]
    return found


def seconds(status: Path) -> float:
    """Return how long a notebook took."""
    return float(json.loads(status.read_text(encoding="utf-8"))["seconds"])


def one_turn(
    one: Target, how: signal.Signals, moment: float, right: dict[Path, bytes]
) -> Iterator[str]:
    """Disturb one run, repeat it undisturbed, and yield what is wrong after either."""
    mark = uuid.uuid4().hex
    run = begin(one, mark)
    sleep(moment)
    run.send_signal(how)
    run.wait()
    end = monotonic() + GRACE
    while (left := marked(mark)) and monotonic() < end:
        sleep(0.1)
    for pid, command in left.items():
        os.kill(pid, signal.SIGKILL)
        yield f"still alive: {command}"
    for path, content in one.files().items():
        if content != right.get(path):
            yield f"not whole, or not what is right: {path.name}"
    if (status := finish(one)) != 0:
        yield f"the next run ends with {status}"
    elif (now := one.files()) != right:
        wrong = {path.name for path in now.keys() | right if now.get(path) != right.get(path)}
        yield f"the next run leaves other files: {', '.join(sorted(wrong))}"


def begin(one: Target, mark: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        one.command,
        cwd=one.tree,
        env=os.environ | {"PYTHONPATH": str(one.tree), MARK: mark},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def finish(one: Target) -> int:
    return begin(one, "").wait(LONGEST)


def marked(mark: str) -> dict[int, str]:
    """Return the processes that carry a mark, which each inherits from the one that began it."""
    wanted = f"{MARK}={mark}".encode()
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if wanted in (folder / "environ").read_bytes().split(b"\0"):
                text = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()
                found[int(folder.name)] = text[:100]
        except OSError:
            continue  # ended in between, or another user's
    return found


if __name__ == "__main__":
    sys.exit(main())
