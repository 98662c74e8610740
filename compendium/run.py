"""Run the notebooks with papermill, two at a time, and only those whose inputs changed.

``python -m compendium.run`` leaves the executed notebooks in ``build/notebooks``, their records in
``build/claims``, the numbers behind their figures in ``build/figures`` and one status file each in
``build/status``. A notebook is run again when it, the library, the compendium, the data or the
locked environment changed, or when something that it left is damaged or missing. Chapter 6 reads
the records of the others and is run last. Whatever a notebook leaves is made in ``build/running``
and moved when it is whole; a second run in the same tree waits for the first.

With ``-p NAME VALUE`` one notebook runs once on your own data. The executed copy goes to the
folder ``--output``, and nothing is recorded against the thesis.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from time import perf_counter
from typing import NoReturn

import nbformat
import papermill
from nbclient.exceptions import DeadKernelError
from papermill.exceptions import PapermillExecutionError
from traitlets.config import Config

from compendium.executed import clean, lighten, name_cells
from compendium.figures.data import FOLDER_VARIABLE
from compendium.parameters import OUT, prepare_folder, read_parameters, read_values
from compendium.processes import alone_in, end_with_make, end_with_parent
from microlib._common import replace_file

ROOT = Path(__file__).resolve().parent.parent
BUILD = ROOT / "build"
LAST = "06_"
INTERRUPTED = 130  # as a shell reports what Ctrl-C ended
# What of the library decides what a notebook shows: its code, and what it learned.
LIBRARY = (".py", ".json")
# Two kernels share the cores, so each keeps to one thread; this also fixes the order of sums.
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class Parser(argparse.ArgumentParser):
    """Says in one line what is wrong with a call."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{message}; --help lists the options.\n")


def main() -> int:
    """Run what the command line asks for; return the exit status."""
    end_with_make()
    os.environ |= THREADS
    os.environ["PYTHONHASHSEED"] = "0"
    try:
        options = parse(sys.argv[1:])
        names = choose(options.names)
        if options.own or options.output:
            return run_own(names, options.own, Path(options.output or "mine"))
        with alone_in(BUILD):
            return build(names, options.jobs, force=options.force)
    except (ValueError, OSError) as error:
        print(one_line(str(error)), file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        # At once, without waiting for the workers: they and their kernels end with this process.
        print("Interrupted; nothing unfinished was kept.", file=sys.stderr, flush=True)
        os._exit(INTERRUPTED)


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    parser = Parser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="notebooks to run, by name or its beginning")
    parser.add_argument("--force", action="store_true", help="run them even if nothing changed")
    parser.add_argument("--jobs", type=int, default=2, help="how many at a time")
    parser.add_argument(
        "-p",
        nargs=2,
        action="append",
        default=[],
        metavar=("NAME", "VALUE"),
        dest="own",
        help="set a parameter of one notebook",
    )
    parser.add_argument("--output", help="folder for a run on your own data, mine if not given")
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


def build(names: list[str], jobs: int, *, force: bool) -> int:
    """Run those of the notebooks that must be; the last chapter only if the others passed."""
    shutil.rmtree(BUILD / "running", ignore_errors=True)  # of a run that was killed
    for is_last in (False, True):
        keys = {name: input_hashes(name) for name in names if name.startswith(LAST) == is_last}
        todo = {n: key for n, key in keys.items() if force or not up_to_date(n, key)}
        for name in sorted(set(keys) - set(todo)):
            print(f"  {name}: up to date")
        # The longest first, so that no core idles at the end; the longer has the larger file.
        order = sorted(todo, key=lambda n: -(ROOT / "notebooks" / f"{n}.ipynb").stat().st_size)
        failures = 0
        calls = {name: (run, name, todo[name]) for name in order}
        for done, (name, message, passed) in enumerate(in_workers(calls, jobs), 1):
            failures += not passed
            text = f"  [{done}/{len(order)}] {name}: {message}"
            print(text, file=sys.stdout if passed else sys.stderr, flush=True)
        if failures:
            return 1
    return 0


def run_own(names: list[str], texts: Sequence[tuple[str, str]], folder: Path) -> int:
    """Run one notebook on the reader's own data; say in one line what is wrong with it, if so."""
    if len(names) != 1:
        raise ValueError(f"-p needs one notebook, got {', '.join(names)}.")
    given = [name for name, _ in texts]
    if twice := sorted({name for name in given if given.count(name) > 1}):
        raise ValueError(f"{twice[0]} must be given once, got it {given.count(twice[0])} times")
    source = ROOT / "notebooks" / f"{names[0]}.ipynb"
    values = read_values(source, dict(texts))
    prepare_folder("--output", folder)
    output = folder / source.name
    calls = {source.stem: (execute_whole, source, output, values, Path.cwd())}
    # To its end, where the pool is closed: closed as Python ends, it may say so in a traceback.
    ((_, message, passed),) = in_workers(calls, 1)
    print(f"{output}: {message}", file=sys.stdout if passed else sys.stderr)
    return 0 if passed else 1


def in_workers(calls: dict[str, tuple], jobs: int) -> Iterable[tuple[str, str, bool]]:
    """Run functions side by side, and yield each one's name, message and success as it ends.

    Each of `calls` holds a function, which returns a message and whether it passed, and its
    arguments.
    """
    # Not as a context, which would wait for the workers if this process is interrupted.
    pool = ProcessPoolExecutor(max_workers=max(1, jobs), initializer=begin)
    runs: dict[Future, str] = {pool.submit(guarded, *call): name for name, call in calls.items()}
    for future in as_completed(runs):
        try:
            yield runs[future], *future.result()
        except BrokenProcessPool:
            yield runs[future], "FAILED: its process was killed", False
    pool.shutdown()


def begin() -> None:
    """End with the parent, which alone heeds Ctrl-C, and drop what kernels say as they end."""
    end_with_parent()
    # A function and not SIG_IGN, which the kernels would inherit.
    signal.signal(signal.SIGINT, lambda *_: None)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


def guarded(function: Callable[..., tuple[str, bool]], *arguments: object) -> tuple[str, bool]:
    """Call a function; tell in one line what was refused, such as room on the disk."""
    try:
        return function(*arguments)
    except (OSError, ValueError) as error:
        return f"FAILED: {one_line(str(error))}", False


def execute_whole(source: Path, output: Path, values: dict, cwd: Path) -> tuple[str, bool]:
    """Execute a notebook; `output` appears when it has ended, well or not."""
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / output.name
        message, passed = execute(source, made, values, cwd)
        if made.exists():
            notebook = nbformat.read(made, as_version=4)
            clean(notebook)
            replace_file(output, lambda file: nbformat.write(notebook, file))
    return message, passed


def execute(source: Path, output: Path, parameters: dict, cwd: Path) -> tuple[str, bool]:
    """Execute a notebook with papermill; return how it went and whether it passed."""
    start = perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        # Each kernel talks over sockets in a folder of its own; the default names collide.
        sockets = Config({"KernelManager": {"transport": "ipc", "ip": f"{folder}/k"}})
        try:
            papermill.execute_notebook(
                source,
                output,
                parameters=parameters,
                cwd=str(cwd),
                kernel_name="python3",
                progress_bar=False,
                config=sockets,
            )
        except PapermillExecutionError as error:
            text = one_line(f"{error.ename}: {error.evalue}")
            return f"FAILED in cell {error.cell_index}: {text}", False
        except DeadKernelError:
            return "FAILED: its kernel was killed", False
    return f"{perf_counter() - start:.1f} s", True


def one_line(text: str) -> str:
    return " ".join(text.split())


def run(name: str, key: dict[str, str]) -> tuple[str, bool]:
    """Execute one notebook; return what to tell the user and whether it passed.

    `key` holds its input hashes, which its status file keeps beside the hashes of what it left.
    """
    for folder in ("notebooks", "claims", "status", "figures", "failed"):
        (BUILD / folder).mkdir(parents=True, exist_ok=True)
    running = BUILD / "running" / name
    shutil.rmtree(running, ignore_errors=True)
    (running / "figures").mkdir(parents=True)
    os.environ[FOLDER_VARIABLE] = str(running / "figures")
    source = ROOT / "notebooks" / f"{name}.ipynb"
    made, record = running / "notebook.ipynb", running / "record.json"
    message, passed = execute(source, made, {"record": str(record.relative_to(ROOT))}, ROOT)
    failed = BUILD / "failed" / f"{name}.ipynb"
    if passed:
        notebook = nbformat.read(made, as_version=4)
        clean(notebook)
        lighten(notebook)
        if str(ROOT) in nbformat.writes(notebook):
            message, passed = "FAILED: an output names a path of this machine", False
    if not passed:
        for part, ending in (("status", "json"), ("notebooks", "ipynb"), ("claims", "json")):
            (BUILD / part / f"{name}.{ending}").unlink(missing_ok=True)
        if made.exists():
            os.replace(made, failed)
        return f"{message} ({failed.relative_to(ROOT)})", False
    nbformat.write(notebook, made)
    # A guide checks nothing against the thesis.
    records = json.loads(record.read_text(encoding="utf-8")) if record.exists() else []
    checks = name_cells(records, notebook)
    record.write_text(json.dumps(checks, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    judged = sum(entry["verdict"] != "result" for entry in checks)
    status = {
        "notebook": name,
        "seconds": float(message.removesuffix(" s")),
        "checks": judged,
        **key,
    }
    publish(name, running, status)
    failed.unlink(missing_ok=True)
    return f"{message}, {judged} {'check' if judged == 1 else 'checks'} passed", True


def publish(name: str, running: Path, status: dict[str, object]) -> None:
    """Move what a run made to where the book looks for it, its status last."""
    places = {
        running / "notebook.ipynb": BUILD / "notebooks" / f"{name}.ipynb",
        running / "record.json": BUILD / "claims" / f"{name}.json",
    }
    places |= {file: BUILD / "figures" / file.name for file in (running / "figures").iterdir()}
    left = [*places.values(), *results_of(name)]
    for made, place in places.items():
        os.replace(made, place)
    status["left"] = {str(path.relative_to(ROOT)): files_hash([path]) for path in sorted(left)}
    text = json.dumps(status, indent=1) + "\n"
    (running / "status.json").write_text(text, encoding="utf-8")
    os.replace(running / "status.json", BUILD / "status" / f"{name}.json")
    shutil.rmtree(running)


def results_of(name: str) -> list[Path]:
    """Return the files that a guide keeps in its own folder."""
    folder = read_parameters(ROOT / "notebooks" / f"{name}.ipynb").get(OUT)
    if folder is None:
        return []
    files = (path for path in (ROOT / str(folder.like)).iterdir() if path.is_file())
    return [path for path in files if not path.name.startswith(".")]


def up_to_date(name: str, key: dict[str, str]) -> bool:
    """Tell whether a notebook was run on the inputs of which `key` holds the hashes, and whether
    all that it left is as it left it."""
    try:
        status = json.loads((BUILD / "status" / f"{name}.json").read_text(encoding="utf-8"))
        left = {ROOT / file: hashed for file, hashed in status["left"].items()}
        made = {BUILD / "notebooks" / f"{name}.ipynb", BUILD / "claims" / f"{name}.json"}
        whole = made <= set(left) and all(files_hash([path]) == left[path] for path in left)
        return whole and key.items() <= status.items()
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return False  # missing, cut off, or anything else but what `publish` writes


def input_hashes(name: str) -> dict[str, str]:
    """Return the version of Python and the hashes of all else that a notebook depends on."""
    hashes = {"notebook_file": files_hash([ROOT / "notebooks" / f"{name}.ipynb"]), **shared_key()}
    if name.startswith(LAST):
        claims = (BUILD / "claims").glob("*.json")
        hashes["claims"] = files_hash(p for p in claims if not p.name.startswith(LAST))
    return hashes


@cache
def shared_key() -> dict[str, str]:
    """Return what all notebooks depend on: the version of Python and hashes by kind of file."""
    return {
        "python": sys.version.split()[0],
        "library": files_hash(p for p in (ROOT / "microlib").rglob("*") if p.suffix in LIBRARY),
        "compendium": files_hash((ROOT / "compendium").rglob("*.py")),
        "data": files_hash(path for path in (ROOT / "data").rglob("*") if path.is_file()),
        "lock": files_hash([ROOT / "environment.txt"]),
    }


def files_hash(files: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for path in sorted(files):
        digest.update(str(path.relative_to(ROOT)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


if __name__ == "__main__":
    sys.exit(main())
