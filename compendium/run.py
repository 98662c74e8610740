"""Run the notebooks with papermill, two at a time, and only those whose inputs changed.

``python -m compendium.run`` leaves the executed notebooks in ``build/notebooks``, their records in
``build/claims``, the numbers behind their figures in ``build/figures`` and one status file each in
``build/status``. A notebook is run again when it, the library, the compendium, the data or the
locked environment changed, or when its last run failed. One that fails does not stop the others:
its page shows how far it came, and the command ends with its name, its cell, the message and exit
status 1. Chapter 6 reads the records of the others and is run last.

With ``-p NAME VALUE`` one notebook runs once on your own data. The executed copy goes to the
folder ``--output``, and nothing is recorded against the thesis.
"""

from __future__ import annotations

import argparse
import fcntl
import hashlib
import json
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path
from time import perf_counter
from typing import Any, NoReturn

import nbformat
import papermill
from nbclient.exceptions import DeadKernelError
from papermill.exceptions import PapermillExecutionError
from traitlets.config import Config

from compendium.executed import clean, error_cell
from compendium.figures.data import FOLDER_VARIABLE
from compendium.parameters import prepare_folder, read_values
from microlib._common import replace_file

ROOT = Path(__file__).resolve().parent.parent
BUILD = ROOT / "build"
LAST = "06_"
INTERRUPTED = 130  # as a shell reports what Ctrl-C ended
# Two kernels share the cores, so each keeps to one thread.
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class Parser(argparse.ArgumentParser):
    """Says in one line what is wrong with a call."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{message}; --help lists the options.\n")


def main() -> int:
    """Run what the command line asks for; return the exit status."""
    os.environ |= THREADS
    try:
        options = parse(sys.argv[1:])
        if options.failures:
            return report_failures()
        names = choose(options.names)
        if options.own or options.output:
            return run_own(names, options.own, Path(options.output or "mine"))
        with alone():
            build(names, options.jobs, force=options.force)
        return report_failures()
    except (ValueError, OSError) as error:
        print(one_line(error), file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        # At once, without waiting for the workers: they and their kernels end with this process.
        print("Interrupted; nothing unfinished was kept.", file=sys.stderr, flush=True)
        os._exit(INTERRUPTED)


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    parser = Parser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("names", nargs="*", help="notebooks to run, by name or its beginning")
    add("--force", action="store_true", help="run them even if nothing changed")
    add("--jobs", type=int, default=2, help="how many at a time")
    add("--failures", action="store_true", help="list the failed ones; run nothing")
    own: dict[str, Any] = {
        "nargs": 2,
        "action": "append",
        "default": [],
        "metavar": ("NAME", "VALUE"),
    }
    add("-p", dest="own", help="set a parameter of one notebook", **own)
    add("--output", help="folder for a run on your own data, mine if not given")
    # A value may begin with a minus, -5e1, which argparse takes for an option unless a space comes
    # first.
    safe = [
        f" {text}" if "-p" in arguments[k - 2 : k - 1] else text for k, text in enumerate(arguments)
    ]
    options = parser.parse_args(safe)
    options.own = [(name, value.removeprefix(" ")) for name, value in options.own]
    return options


def choose(wanted: Sequence[str]) -> list[str]:
    """Return the notebooks whose names begin as wanted, all of them if nothing is."""
    every = sorted(path.stem for path in (ROOT / "notebooks").glob("[0-9]*.ipynb"))
    for name in wanted:
        if not any(stem.startswith(name) for stem in every):
            near = get_close_matches(name, every, n=1)
            hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(every)}."
            raise ValueError(f"No notebook is called {name}; {hint}")
    return [stem for stem in every if not wanted or stem.startswith(tuple(wanted))]


@contextmanager
def alone() -> Iterator[None]:
    """Hold the build folder; wait, and say so, while another process holds it."""
    BUILD.mkdir(exist_ok=True)
    with (BUILD / ".lock").open("w") as lock:  # the system frees it, however its holder ends
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            text = f"Another run is at work in {BUILD}; this one waits until it has ended."
            print(text, file=sys.stderr, flush=True)
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def build(names: list[str], jobs: int, *, force: bool) -> None:
    """Run those of the notebooks that must be, the last chapter after the others."""
    for folder in (".running", "notebooks", "claims", "status", "figures"):
        (BUILD / folder).mkdir(exist_ok=True)
    for is_last in (False, True):
        keys = {name: key_of(name) for name in names if name.startswith(LAST) == is_last}
        todo = {n: key for n, key in keys.items() if force or not up_to_date(n, key)}
        print(*(f"  {name}: up to date\n" for name in keys if name not in todo), sep="", end="")
        # The longest first, so that no core idles at the end; the longer has the larger file.
        order = sorted(todo, key=lambda n: -(ROOT / "notebooks" / f"{n}.ipynb").stat().st_size)
        calls = {name: (run, name, todo[name]) for name in order}
        for done, (name, message, passed) in enumerate(in_workers(calls, jobs), 1):
            text = f"  [{done}/{len(order)}] {name}: {message}"
            print(text, file=sys.stdout if passed else sys.stderr, flush=True)


def failures() -> dict[str, str]:
    """Return the notebooks whose last run failed, each with its cell and message."""
    told = {path.stem: read_status(path.stem) for path in sorted((BUILD / "status").glob("*.json"))}
    return {name: status["failed"] for name, status in told.items() if status.get("failed")}


def report_failures() -> int:
    """List what failed; return the exit status."""
    lines = [f"  {name}: {message}" for name, message in failures().items()]
    if lines:
        print("These notebooks failed:", *lines, sep="\n", file=sys.stderr)
    return 1 if lines else 0


def run_own(names: list[str], texts: Sequence[tuple[str, str]], folder: Path) -> int:
    """Run one notebook on the reader's own data; say in one line what is wrong with it, if so."""
    if len(names) != 1:
        raise ValueError(f"-p needs one notebook, got {', '.join(names)}.")
    source = ROOT / "notebooks" / f"{names[0]}.ipynb"
    values = read_values(source, dict(texts))
    prepare_folder("--output", folder)
    output = folder / source.name
    calls = {source.stem: (execute, source, output, values, Path.cwd())}
    # To its end, where the pool is closed: closed as Python ends, it may say so in a traceback.
    ((_, message, passed),) = in_workers(calls, 1)
    print(f"{output}: {message}", file=sys.stdout if passed else sys.stderr)
    return 0 if passed else 1


def in_workers(calls: dict[str, tuple], jobs: int) -> Iterator[tuple[str, str, bool]]:
    """Run functions side by side, and yield each one's name, message and success as it ends.

    Each of `calls` holds a function, which returns a message and whether it passed, and its
    arguments.
    """
    # Not as a context, which would wait for the workers if this process is interrupted.
    pool = ProcessPoolExecutor(max_workers=max(1, jobs), initializer=begin)
    runs = {pool.submit(*call): name for name, call in calls.items()}
    for future in as_completed(runs):
        try:
            yield runs[future], *future.result()
        except BrokenProcessPool:
            yield runs[future], "FAILED: its process was killed", False
        except (OSError, ValueError) as error:
            yield runs[future], f"FAILED: {one_line(error)}", False
    pool.shutdown()


def begin() -> None:
    """End with the parent, which alone heeds Ctrl-C, and drop what kernels say as they end."""

    def end_with_parent(parent: Any) -> None:
        parent.join()
        os._exit(1)

    parent = multiprocessing.parent_process()
    threading.Thread(target=end_with_parent, args=(parent,), daemon=True).start()
    # A function and not SIG_IGN, which the kernels would inherit.
    signal.signal(signal.SIGINT, lambda *_: None)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


def execute(source: Path, output: Path, values: dict, cwd: Path) -> tuple[str, bool]:
    """Execute a notebook with papermill; return how it went and whether it passed.

    `output` appears when the notebook has ended, well or not.
    """
    start, message, passed = perf_counter(), "", True
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / output.name
        # Each kernel talks over sockets in a folder of its own; the default names collide.
        sockets = Config({"KernelManager": {"transport": "ipc", "ip": f"{folder}/k"}})
        how: dict[str, Any] = {"kernel_name": "python3", "progress_bar": False, "config": sockets}
        try:
            papermill.execute_notebook(source, made, values, cwd=str(cwd), **how)
            message = f"{perf_counter() - start:.1f} s"
        except PapermillExecutionError as error:
            message, passed = one_line(f"{error.ename}: {error.evalue}"), False
        except DeadKernelError:
            message, passed = "FAILED: its kernel was killed", False
        if made.exists():
            notebook = nbformat.read(made, as_version=4)
            if cell := error_cell(notebook):
                message = f"FAILED in cell {cell}: {message}"
            clean(notebook)
            replace_file(output, lambda file: nbformat.write(notebook, file))
    return message, passed


def one_line(text: object) -> str:
    return " ".join(str(text).split())


def run(name: str, key: str) -> tuple[str, bool]:
    """Execute a notebook of the book; what it leaves appears when it has ended, its status last."""
    source, status = ROOT / "notebooks" / f"{name}.ipynb", BUILD / "status" / f"{name}.json"
    made, record = (BUILD / ".running" / f"{name}.{kind}" for kind in ("ipynb", "json"))
    for old in (made, record, status):
        old.unlink(missing_ok=True)
    os.environ[FOLDER_VARIABLE] = str(BUILD / "figures")
    start = perf_counter()
    message, passed = execute(source, made, {"record": str(record.relative_to(ROOT))}, ROOT)
    # A guide checks nothing against the thesis.
    records = json.loads(record.read_text(encoding="utf-8")) if record.exists() else []
    if made.exists():
        notebook = nbformat.read(made, as_version=4)
        if passed and str(ROOT) in nbformat.writes(notebook):
            message, passed = "FAILED: an output names a path of this machine", False
        os.replace(made, BUILD / "notebooks" / made.name)
    write_json(BUILD / "claims" / record.name, records)
    checks = sum(entry["verdict"] != "result" for entry in records)
    told = {"notebook": name, "seconds": round(perf_counter() - start, 1), "checks": checks}
    write_json(status, told | {"failed": "" if passed else message, "key": key})
    if passed:
        message += f", {checks} {'check' if checks == 1 else 'checks'} passed"
    return message, passed


def write_json(path: Path, content: object) -> None:
    text = json.dumps(content, indent=1, ensure_ascii=False) + "\n"
    replace_file(path, lambda file: file.write_text(text, encoding="utf-8"))


def read_status(name: str) -> dict:
    """Return what the last run of a notebook left; nothing if that is missing or damaged."""
    try:
        return dict(json.loads((BUILD / "status" / f"{name}.json").read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return {}


def up_to_date(name: str, key: str) -> bool:
    """Tell whether a notebook was run well on the inputs of which `key` is the hash."""
    made = (BUILD / "notebooks" / f"{name}.ipynb", BUILD / "claims" / f"{name}.json")
    status = read_status(name)
    return status.get("key") == key and not status["failed"] and all(p.exists() for p in made)


def key_of(name: str) -> str:
    """Return a hash of all that a notebook depends on, the version of Python among it."""
    files = [ROOT / "notebooks" / f"{name}.ipynb", ROOT / "environment.txt"]
    files += [p for folder in ("microlib", "compendium") for p in (ROOT / folder).rglob("*.py")]
    files += [p for p in (ROOT / "data").rglob("*") if p.is_file() and p.suffix != ".pyc"]
    if name.startswith(LAST):
        files += [p for p in (BUILD / "claims").glob("*.json") if not p.name.startswith(LAST)]
    digest = hashlib.sha256(sys.version.encode())
    for path in sorted(files):
        digest.update(str(path.relative_to(ROOT)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


if __name__ == "__main__":
    sys.exit(main())
