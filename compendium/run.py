"""Run the notebooks with papermill, two at a time, and only those whose inputs changed.

``python -m compendium.run`` leaves the executed notebooks in ``build/notebooks``, their records in
``build/claims``, the numbers behind their figures in ``build/figures``, one status file each in
``build/status``, and in ``build/logs`` what their kernels wrote elsewhere. A notebook is run again
when it, the library, the compendium, the data or the installed packages changed, when its last run
failed, or when a file of that run is missing. One that fails does not stop the others: its page
shows how far it came, and the command ends with its name, its cell, the message and exit status 1.
Chapter 6 reads the records of the others and is run last.

With ``-p NAME VALUE`` one notebook runs once on your own data. The executed copy goes to the
folder ``--output``, and nothing is recorded against the thesis.
"""

from __future__ import annotations

import argparse
import ast
import fcntl
import hashlib
import json
import logging
import os
import re
import shutil
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from contextlib import contextmanager
from datetime import datetime
from difflib import get_close_matches
from functools import partial
from importlib.metadata import distributions
from pathlib import Path
from time import perf_counter
from typing import Any, NoReturn

from compendium import ROOT
from compendium.execution import execute, interrupt_kernels, interrupted, one_line
from compendium.figures.data import FOLDER_VARIABLE
from compendium.ledger import write_json
from compendium.parameters import prepare_folder, read_values

BUILD = ROOT / "build"
#: What is locked: for the book, for its optional pages, for tests, and for JupyterLab.
LOCKS = [ROOT / f"{name}.txt" for name in ("environment", "extras", "test", "lab")]
LAST = "06_"
#: Notebooks that take twice as long as any other.
LONGEST = ("05_", "08_uncertainty")
#: What a run leaves of each notebook.
LEFT = ("notebooks/{}.ipynb", "claims/{}.json", "logs/{}.txt", "status/{}.json")
INTERRUPTED = 130  # as a shell reports what Ctrl-C ended
#: Seconds that a cell of the book may take; the longest takes half a minute.
CELL_LIMIT = 1200
# Two kernels share the cores, so each keeps to one thread.
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class Parser(argparse.ArgumentParser):
    """Says in one line what is wrong with a call."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{message}; --help lists the options.\n")


def main() -> int:
    """Run what the command line asks for; return the exit status."""
    os.environ |= THREADS
    logging.disable()  # what papermill logs of a failure is in our message
    try:
        options = parse(sys.argv[1:])
        if options.failures:
            return report_failures()
        names = choose(options.names)
        if options.own or options.output:
            return run_own(names, options.own, Path(options.output or "mine"))
        reject_replaced_packages()
        with build_lock():
            build(names, options.jobs, force=options.force)
        failed = report_failures(names)
        return INTERRUPTED if interrupted.is_set() else failed
    except (ValueError, OSError) as error:
        print(one_line(error), file=sys.stderr)
        return 1
    except KeyboardInterrupt:  # while no kernel ran
        return INTERRUPTED


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    parser = Parser(description="Run the notebooks, or with -p one of them on your own data.")
    add = parser.add_argument
    add("names", nargs="*", help="notebooks to run, by name or its beginning")
    add("--force", action="store_true", help="run them even if nothing changed")
    add("--jobs", type=int, default=2, help="how many at a time")
    add("--failures", action="store_true", help="list the failed ones; run nothing")
    text, names = "set a parameter of one notebook", ("NAME", "VALUE")
    add("-p", dest="own", help=text, nargs=2, action="append", default=[], metavar=names)
    add("--output", help="folder for a run on your own data, mine if not given")
    # A value may begin with a minus, -5e1, which argparse takes for an option unless a space comes
    # first.
    safe = [
        f" {text}" if "-p" in arguments[k - 2 : k - 1] else text for k, text in enumerate(arguments)
    ]
    options = parser.parse_intermixed_args(safe)
    options.own = [(name, value.removeprefix(" ")) for name, value in options.own]
    return options


def reject_replaced_packages() -> None:
    """Raise if PYTHONPATH replaces packages, since the book states the installed versions."""
    folders = list(filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep)))
    replaced = {one.name for one in distributions(path=folders)} - {"microlib-thesis"}
    if replaced:
        names = ", ".join(sorted(replaced))
        raise ValueError(f"PYTHONPATH must not replace installed packages, got one with {names}.")


def choose(wanted: Sequence[str]) -> list[str]:
    """Return the notebooks whose names begin as wanted, all of them if nothing is."""
    every = every_notebook()
    for name in wanted:
        if not any(stem.startswith(name) for stem in every):
            near = get_close_matches(name, every, n=1)
            hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(every)}."
            raise ValueError(f"No notebook is called {name}; {hint}")
    return [stem for stem in every if not wanted or stem.startswith(tuple(wanted))]


def every_notebook() -> list[str]:
    return sorted(path.stem for path in (ROOT / "notebooks").glob("[0-9]*.ipynb"))


@contextmanager
def build_lock() -> Iterator[None]:
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


def build(names: Sequence[str], jobs: int, *, force: bool) -> None:
    """Run those of the notebooks that must be, the last chapter after the others."""
    for name in {path.stem for path in BUILD.glob("*/[0-9]*.*")} - {*every_notebook()}:
        remove(name)  # what is left of a notebook that was renamed or deleted
    for is_last in (False, True):
        keys = {name: key_of(name) for name in names if name.startswith(LAST) == is_last}
        todo = {n: key for n, key in keys.items() if force or not up_to_date(n, key)}
        print(*(f"  {name}: up to date\n" for name in keys if name not in todo), sep="", end="")
        # The longest first, so that no core idles at the end; of the others the larger file.
        order = sorted(
            todo,
            key=lambda n: (
                not n.startswith(LONGEST),
                -(ROOT / f"notebooks/{n}.ipynb").stat().st_size,
            ),
        )
        calls = {name: partial(run, name, todo[name]) for name in order}
        for done, (name, message, passed) in enumerate(run_all(calls, jobs), 1):
            text = f"  [{done}/{len(order)}] {name}: {message}"
            print(text, file=sys.stdout if passed else sys.stderr, flush=True)


def run_all(
    calls: Mapping[str, Callable[[], tuple[str, bool]]], jobs: int
) -> Iterator[tuple[str, str, bool]]:
    """Run functions side by side, and yield each one's name, message and success as it ends.

    A signal to end goes to the kernels. Each is waited for: a notebook that moves a stage stops it.
    """
    ends = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    heeded = [one for one in ends if signal.getsignal(one) is not signal.SIG_IGN]  # unlike in nohup
    before = {one: signal.signal(one, interrupt_kernels) for one in heeded}
    with ThreadPoolExecutor(max(1, jobs)) as pool:
        runs = {pool.submit(call): name for name, call in calls.items()}
        while runs:
            if interrupted.is_set():
                for future in runs:
                    future.cancel()  # if it has not begun
            # In short waits, between which a signal is heeded that another thread received.
            for future in wait(runs, timeout=0.5, return_when=FIRST_COMPLETED).done:
                try:
                    message, passed = future.result()
                except Exception as error:  # such as a full disk, without room for a status
                    message, passed = f"FAILED: {one_line(error) or 'interrupted'}", False
                yield runs.pop(future), message, passed
    for one, handler in before.items():
        signal.signal(one, handler)


def failures() -> dict[str, str]:
    """Return the notebooks that failed or were not run, each with the reason."""
    states = {name: read_status(name).get("failed", "it was not run") for name in every_notebook()}
    return {name: message for name, message in states.items() if message}


def report_failures(ran: Sequence[str] = ()) -> int:
    """List the failed notebooks, and return the exit status.

    The list includes those that were not in this call and, with no `ran`, also those never run.
    """
    lines = []
    for name, message in failures().items():
        status = read_status(name)
        if status or name in ran or not ran:
            earlier = f" (earlier, {status['when']})" if ran and name not in ran else ""
            lines.append(f"  {name}{earlier}: {message}")
    if lines:
        print("These notebooks failed:", *lines, sep="\n", file=sys.stderr)
    return 1 if lines else 0


def run_own(names: list[str], texts: Sequence[tuple[str, str]], folder: Path) -> int:
    """Run one notebook on the reader's own data; say in one line what is wrong with it, if so."""
    if len(names) != 1:
        raise ValueError(f"-p needs one notebook, got {', '.join(names)}.")
    source = ROOT / "notebooks" / f"{names[0]}.ipynb"
    values = read_values(source, texts)
    prepare_folder("--output", folder)
    output, log = folder / source.name, folder / f"{source.stem}.log.txt"
    log.unlink(missing_ok=True)
    call = partial(execute, source, output, values, Path.cwd(), log=log)
    ((_, message, passed),) = run_all({source.stem: call}, 1)
    print(f"{output}: {message}", file=sys.stdout if passed else sys.stderr)
    return INTERRUPTED if interrupted.is_set() else int(not passed)


def run(name: str, key: str) -> tuple[str, bool]:
    """Execute a notebook of the book; what it leaves appears when it has ended, its status last.

    What an earlier run left is removed first. While the notebook runs, its status is that its run
    did not end.
    """
    source, work = ROOT / "notebooks" / f"{name}.ipynb", BUILD / ".running" / name
    remove(name)
    shutil.rmtree(work, ignore_errors=True)
    for folder in (work / "figures", *(BUILD / Path(file).parent for file in LEFT)):
        folder.mkdir(parents=True, exist_ok=True)
    made, claims, log, status = (BUILD / file.format(name) for file in LEFT)
    log.touch()
    about: dict[str, Any] = {"notebook": name, "key": key, "seconds": 0.0, "checks": 0}
    about["when"], about["figures"] = f"{datetime.now():%Y-%m-%d %H:%M}", []
    about["interpreter"] = os.path.relpath(sys.executable, ROOT)
    write_json(status, about | {"failed": "FAILED: its run did not end"})
    start, record = perf_counter(), work / f"{name}.json"  # which names its notebook
    values = {"record": str(record.relative_to(ROOT))}
    options: dict[str, Any] = {"log": log, "cell_limit": CELL_LIMIT}
    options["variables"] = {FOLDER_VARIABLE: str(work / "figures")}
    if needed := [one for one in failures() if name.startswith(LAST) and one < LAST]:
        text = f"FAILED: it reads what other chapters record; run {' '.join(needed)} first"
        write_json(status, about | {"failed": text})
        return text, False
    message, passed = execute(source, work / source.name, values, ROOT, **options)
    if passed and str(ROOT) in (work / source.name).read_text(encoding="utf-8"):
        message, passed = "FAILED: an output names a path of this machine", False
    # A guide checks nothing against the thesis.
    records = json.loads(record.read_text(encoding="utf-8")) if record.exists() else []
    os.replace(work / source.name, made)
    write_json(claims, records)
    figures = sorted(path.name for path in (work / "figures").iterdir())
    (BUILD / "figures").mkdir(exist_ok=True)
    for file in figures:
        os.replace(work / "figures" / file, BUILD / "figures" / file)
    shutil.rmtree(work)
    checks = sum(entry["verdict"] != "result" for entry in records) + count_checks(source)
    about |= {"seconds": round(perf_counter() - start, 1), "checks": checks, "figures": figures}
    write_json(status, about | {"failed": "" if passed else message})
    if passed:
        message += f", {checks} {'check' if checks == 1 else 'checks'} passed"
    return message, passed


def count_checks(notebook: Path) -> int:
    """Return the number of assertions and comparisons that a notebook does not record."""
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    code = ("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    nodes = [node for text in code for node in ast.walk(ast.parse(re.sub("(?m)^%.*", "", text)))]
    calls = [node.func for node in nodes if isinstance(node, ast.Call)]
    names = [getattr(func, "id", getattr(func, "attr", "")) for func in calls]
    compared = sum(name in ("check_equation", "compare") for name in names)
    return compared + sum(isinstance(node, ast.Assert) for node in nodes)


def read_status(name: str) -> dict:
    """Return what the last run of a notebook left; nothing if that is missing or damaged."""
    try:
        return dict(json.loads((BUILD / "status" / f"{name}.json").read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return {}


def left_by(name: str) -> list[Path]:
    """Return the files that the last run of a notebook left, its status last."""
    figures = [BUILD / "figures" / file for file in read_status(name).get("figures", [])]
    return figures + [BUILD / file.format(name) for file in LEFT]


def remove(name: str) -> None:
    for path in left_by(name):
        path.unlink(missing_ok=True)


def up_to_date(name: str, key: str) -> bool:
    """Tell whether a notebook was run well on the inputs of which `key` is the hash."""
    status = read_status(name)
    whole = all(path.exists() for path in left_by(name))
    return status.get("key") == key and not status["failed"] and whole


def key_of(name: str) -> str:
    """Return a hash of all that a notebook depends on, the installed packages among it."""
    files = [ROOT / "notebooks" / f"{name}.ipynb"]
    files += [p for folder in ("microlib", "compendium") for p in (ROOT / folder).rglob("*.py")]
    files += [p for p in (ROOT / "data").rglob("*") if p.is_file() and p.suffix != ".pyc"]
    if name.startswith(LAST):
        files += [p for p in (BUILD / "claims").glob("*.json") if not p.name.startswith(LAST)]
    packages = sorted(f"{name} {version}" for name, version in used_packages().items())
    digest = hashlib.sha256("\n".join([sys.version, *packages]).encode())
    for path in sorted(files):
        digest.update(str(path.relative_to(ROOT)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def used_packages() -> dict[str, str]:
    """Return the versions of what is installed, without what only tests or JupyterLab add."""
    book, extras, *others = (
        set(re.findall(r"^([\w.-]+)==", lock.read_text(encoding="utf-8"), re.M)) for lock in LOCKS
    )
    without = set.union(*others) - book - extras
    named = {re.sub("[-_.]+", "-", one.name).lower(): one.version for one in distributions()}
    return {name: version for name, version in named.items() if name not in without}


if __name__ == "__main__":
    sys.exit(main())
