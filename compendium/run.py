"""Run the notebooks with papermill, two at a time, and only those whose inputs changed.

``python -m compendium.run`` leaves the executed notebooks in ``build/notebooks``, their records in
``build/claims`` and one status file each in ``build/status``. A notebook is run again when it, the
library, the compendium, the data or the locked environment changed. Chapter 6 reads the records of
the others and is run last.

With ``-p NAME VALUE`` one notebook runs once on your own data. The executed copy goes to the
folder ``--output``, and nothing is recorded against the thesis.
"""

from __future__ import annotations

import argparse
import base64
import hashlib
import io
import json
import os
import sys
import tempfile
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import cache
from pathlib import Path
from time import perf_counter

import nbformat
import papermill
import yaml
from papermill.exceptions import PapermillExecutionError
from PIL import Image
from traitlets.config import Config

from compendium.figures.data import FOLDER_VARIABLE

ROOT = Path(__file__).resolve().parent.parent
BUILD = ROOT / "build"
LAST = "06_"
LARGE_DRAWING = 60_000  # bytes above which a palette does not suit a picture
# Two kernels share the cores, so each keeps to one thread; this also fixes the order of sums.
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
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
        help="set a parameter of one notebook, as papermill does",
    )
    parser.add_argument("--output", default="mine", help="folder for a run with -p")
    options = parser.parse_args()
    os.environ |= THREADS
    os.environ["PYTHONHASHSEED"] = "0"
    os.environ[FOLDER_VARIABLE] = str(BUILD / "figures")

    every = sorted(path.stem for path in (ROOT / "notebooks").glob("[0-9]*.ipynb"))
    chosen = [n for n in every if not options.names or n.startswith(tuple(options.names))]
    if not chosen:
        print(f"No notebook is called {' or '.join(options.names)}; there are {', '.join(every)}.")
        return 1
    if options.own:
        return run_own(chosen, dict(options.own), Path(options.output))
    failures = 0
    first = [name for name in chosen if not name.startswith(LAST)]
    last = [name for name in chosen if name.startswith(LAST)]
    for batch in (first, last):
        keys = {name: input_hashes(name) for name in batch}
        todo = {n: key for n, key in keys.items() if options.force or not up_to_date(n, key)}
        for name in sorted(set(batch) - set(todo)):
            print(f"  {name}: up to date")
        failures += run_all(todo, options.jobs)
        if failures:
            break
    return 1 if failures else 0


def run_own(names: list[str], values: dict[str, str], folder: Path) -> int:
    """Run one notebook on the reader's own data; say in one line what is wrong with it, if so."""
    if len(names) != 1:
        print(f"-p needs one notebook, not {', '.join(names)}.")
        return 1
    source = ROOT / "notebooks" / f"{names[0]}.ipynb"
    unknown = set(values) - set(papermill.inspect_notebook(source))
    if unknown:
        print(f"{names[0]} has no parameter {', '.join(sorted(unknown))}.")
        return 1
    folder.mkdir(parents=True, exist_ok=True)
    output = folder / source.name
    # As on papermill's own command line: 2.5 is a number, mine.tif a text.
    parameters = {name: yaml.safe_load(value) for name, value in values.items()}
    message, passed = execute(source, output, parameters, Path.cwd())
    print(f"{output}: {message}")
    return 0 if passed else 1


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
            return f"FAILED in cell {error.cell_index}: {error.ename}: {error.evalue}", False
    return f"{perf_counter() - start:.1f} s", True


def run_all(keys: dict[str, dict[str, str]], jobs: int) -> int:
    """Run notebooks side by side, print a line for each as it ends, and return how many failed.

    `keys` holds each notebook's input hashes.
    """
    failures = 0
    # The longest first, so that no core idles at the end; a longer notebook has the larger file.
    names = sorted(keys, key=lambda n: -(ROOT / "notebooks" / f"{n}.ipynb").stat().st_size)
    with ProcessPoolExecutor(max_workers=max(1, jobs), initializer=hush) as pool:
        runs = {pool.submit(run, name, keys[name]): name for name in names}
        for done, future in enumerate(as_completed(runs), 1):
            message, passed = future.result()
            failures += not passed
            print(f"  [{done}/{len(names)}] {runs[future]}: {message}", flush=True)
    return failures


def hush() -> None:
    """Drop what kernels write to the terminal as they shut down; their errors are returned."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


def run(name: str, key: dict[str, str]) -> tuple[str, bool]:
    """Execute one notebook; return what to tell the user and whether it passed.

    `key` holds its input hashes, which its status file keeps.
    """
    for folder in ("notebooks", "claims", "status", "failed"):
        (BUILD / folder).mkdir(parents=True, exist_ok=True)
    output = BUILD / "notebooks" / f"{name}.ipynb"
    failed = BUILD / "failed" / f"{name}.ipynb"
    record = BUILD / "claims" / f"{name}.json"
    for stale in (output, failed, record, BUILD / "status" / f"{name}.json"):
        stale.unlink(missing_ok=True)
    source = ROOT / "notebooks" / f"{name}.ipynb"
    message, passed = execute(source, failed, {"record": str(record.relative_to(ROOT))}, ROOT)
    if not passed:
        return f"{message} ({failed.relative_to(ROOT)})", False
    notebook = nbformat.read(failed, as_version=4)
    clean(notebook)
    lighten(notebook)
    if str(ROOT) in nbformat.writes(notebook):
        return f"FAILED: an output names a path of this machine ({failed.relative_to(ROOT)})", False
    nbformat.write(notebook, output)
    failed.unlink()
    if not record.exists():
        record.write_text("[]\n", encoding="utf-8")  # a guide checks nothing against the thesis
    checks = name_cells(json.loads(record.read_text()), notebook)
    record.write_text(json.dumps(checks, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    judged = sum(entry["verdict"] != "result" for entry in checks)
    status = {
        "notebook": name,
        "seconds": float(message.removesuffix(" s")),
        "checks": judged,
        **key,
    }
    (BUILD / "status" / f"{name}.json").write_text(json.dumps(status, indent=1) + "\n")
    return f"{message}, {judged} {'check' if judged == 1 else 'checks'} passed", True


def name_cells(records: list[dict], notebook: nbformat.NotebookNode) -> list[dict]:
    """Put a cell's lasting id in place of the number that it had when it was executed."""
    ids = {f"[{c.execution_count}]": c.id for c in notebook.cells if c.cell_type == "code"}
    return [record | {"cell": ids.get(record.get("cell", ""), "")} for record in records]


def clean(notebook: nbformat.NotebookNode) -> None:
    """Remove what papermill and the kernel left that names a time or a place on this machine."""
    notebook.metadata.pop("papermill", None)
    for cell in notebook.cells:
        cell.metadata.pop("papermill", None)
        cell.metadata.pop("execution", None)
        if "injected-parameters" in cell.metadata.get("tags", []):
            cell.metadata.tags.append("remove-cell")


def lighten(notebook: nbformat.NotebookNode) -> None:
    """Store the pictures small: drawings with a palette, photographs and noise as JPEG."""
    for output in (o for cell in notebook.cells for o in cell.get("outputs", [])):
        data = output.get("data", {})
        if "image/png" not in data:
            continue
        picture = Image.open(io.BytesIO(base64.b64decode(data["image/png"]))).convert("RGB")
        drawing = io.BytesIO()
        palette = picture.quantize(128, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
        palette.save(drawing, "PNG", optimize=True)
        photograph = io.BytesIO()
        picture.save(photograph, "JPEG", quality=82, optimize=True)
        if drawing.tell() > LARGE_DRAWING and photograph.tell() < drawing.tell():
            del data["image/png"]
            data["image/jpeg"] = base64.b64encode(photograph.getvalue()).decode()
        else:
            data["image/png"] = base64.b64encode(drawing.getvalue()).decode()


def up_to_date(name: str, key: dict[str, str]) -> bool:
    """Tell whether a notebook has been run on the inputs of which `key` holds the hashes."""
    status = BUILD / "status" / f"{name}.json"
    made = [BUILD / "notebooks" / f"{name}.ipynb", BUILD / "claims" / f"{name}.json", status]
    if not all(path.exists() for path in made):
        return False
    return key.items() <= json.loads(status.read_text()).items()


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
        "library": files_hash((ROOT / "microlib").rglob("*.py")),
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
