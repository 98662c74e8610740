"""Render the executed notebooks and the text as a book: ``build/html``, whole or the one before.

``python -m compendium.book`` works in a folder of its own in ``build/rendered`` and lets the link
``build/html`` point to it once it is complete. The page of a notebook that failed or was not run
says so, and what it would have computed is marked wherever it is quoted; the command then lists
these notebooks and ends with exit status 1.
"""

from __future__ import annotations

import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
from contextlib import redirect_stdout
from pathlib import Path

import nbformat
from click import ClickException
from nbformat.v4 import new_output

from compendium import MISSING, ROOT, run

STRICT = ("--warningiserror", "--nitpick", "--keep-going", "--quiet")
PLACEHOLDER = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 400 60" width="400">'
    '<text x="200" y="38" font-size="24" text-anchor="middle" fill="#B34700">'
    f"{MISSING}</text></svg>"
)


def main() -> int:
    """Render the book; return the exit status."""
    if sys.flags.optimize > 1:
        print("The pages are made of docstrings, which python -OO leaves out.", file=sys.stderr)
        return 1
    try:
        with run.build_lock():
            folder = prepare()
            render(folder)
            publish(folder / "_build" / "html", run.BUILD / "html")
        return run.report_failures()
    except (OSError, RuntimeError, ClickException, subprocess.CalledProcessError) as error:
        print(f"The book was not built: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("Interrupted; the book is the one before.", file=sys.stderr)
        return run.INTERRUPTED


def prepare() -> Path:
    """Lay out what the book is made from, from scratch: pages quote records that Sphinx does not
    watch. Return a new folder to make it in."""
    for old in (ROOT / "book" / "notebooks", ROOT / "book" / "generated"):
        shutil.rmtree(old, ignore_errors=True)
    pages = ROOT / "book" / "notebooks"
    pages.mkdir()
    failed = run.failures()
    for name in run.every_notebook():
        made = run.BUILD / "notebooks" / f"{name}.ipynb"
        if name in failed:
            mark_failure(made, pages / made.name, failed[name])
        else:
            shutil.copy(made, pages)
    rendered, shown = run.BUILD / "rendered", (run.BUILD / "html").resolve()
    rendered.mkdir(parents=True, exist_ok=True)
    for old in rendered.iterdir():
        if not shown.is_relative_to(old):  # of a build that was killed, or of one before
            shutil.rmtree(old)
    folder = Path(tempfile.mkdtemp(dir=rendered))
    folder.chmod(0o755)  # mkdtemp lets the owner alone look into it
    return folder


def mark_failure(made: Path, page: Path, message: str) -> None:
    """Write the page of a notebook that failed: as far as it came, and what failed and when."""
    source = ROOT / "notebooks" / made.name
    notebook = nbformat.read(made if made.exists() else source, as_version=4)
    when = run.read_status(made.stem).get("when", "")
    after = f" ({when})" if when else ""
    text = f"**Not computed.** The notebook of this page did not run to its end{after}:"
    note = f"\n\n:::{{error}}\n{text}\n\n```text\n{message}\n```\n:::\n"
    first = notebook.cells[0]
    first.source = re.sub(
        r"^# .*$", lambda title: title[0] + note, first.source, count=1, flags=re.M
    )
    for cell in notebook.cells:
        if "figure" in cell.metadata.get("mystnb", {}) and not cell.outputs:
            cell.outputs = [new_output("display_data", {"image/svg+xml": PLACEHOLDER})]
    nbformat.write(notebook, page)


def render(folder: Path) -> None:
    """Let jupyter-book make the pages in a folder; its warnings go to the terminal.

    What is known of this build is written first, since a page shows it."""
    command = [sys.executable, "-m", "book.make_certificate", str(run.BUILD / "certificate")]
    subprocess.run(command, check=True, cwd=ROOT)
    # Here, since it warns of its own use of click when it is imported.
    from jupyter_book.cli.main import main as jupyter_book  # type: ignore[import-untyped]

    command = ["build", str(ROOT / "book"), "--path-output", str(folder), *STRICT]
    with redirect_stdout(io.StringIO()):  # which names the folder
        jupyter_book(command, standalone_mode=False)


def publish(html: Path, link: Path) -> None:
    """Let the link point to the new book, in one step."""
    new = link.with_name(".html")
    new.unlink(missing_ok=True)
    new.symlink_to(html.relative_to(link.parent))
    os.replace(new, link)


if __name__ == "__main__":
    sys.exit(main())
