"""Render the executed notebooks and the text as a book: ``build/html``, whole or the one before.

``python -m compendium.book`` works in a folder of its own in ``build/rendered`` and lets the link
``build/html`` point to it once it is complete. With a notebook that failed the other pages are
rendered all the same; the command then lists what failed and ends with exit status 1.
"""

from __future__ import annotations

import io
import os
import shutil
import subprocess
import sys
import tempfile
from contextlib import redirect_stdout
from pathlib import Path

from click import ClickException

from compendium.run import BUILD, INTERRUPTED, ROOT, alone, failures, report_failures

RENDERED = BUILD / "rendered"
STRICT = ("--warningiserror", "--nitpick", "--keep-going", "--quiet")


def main() -> int:
    """Render the book; return the exit status."""
    try:
        with alone():
            prepare()
            folder = Path(tempfile.mkdtemp(dir=RENDERED))
            folder.chmod(0o755)  # mkdtemp lets the owner alone look into it
            html = folder / "_build" / "html"
            try:
                render(folder)
            except (RuntimeError, ClickException, SystemExit):
                # Pages that quote what a failed notebook did not record say so as errors.
                if not failures() or not (html / "index.html").exists():
                    raise
            publish(html, BUILD / "html")
        return report_failures()
    except (OSError, RuntimeError, ClickException, subprocess.CalledProcessError) as error:
        print(f"The book was not built: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("Interrupted; the book is the one before.", file=sys.stderr)
        return INTERRUPTED


def prepare() -> None:
    """Lay out what the book is made from, from scratch: pages quote records that Sphinx does not
    watch."""
    for old in (ROOT / "book" / "notebooks", ROOT / "book" / "generated"):
        shutil.rmtree(old, ignore_errors=True)
    shutil.copytree(BUILD / "notebooks", ROOT / "book" / "notebooks")
    RENDERED.mkdir(parents=True, exist_ok=True)
    shown = (BUILD / "html").resolve()
    for folder in RENDERED.iterdir():
        if not shown.is_relative_to(folder):  # of a build that was killed, or of one before
            shutil.rmtree(folder)


def render(folder: Path) -> None:
    """Let jupyter-book make the pages in a folder; its warnings go to the terminal.

    What is known of this build is written first, since a page shows it."""
    command = [sys.executable, "-m", "book.make_certificate", str(BUILD / "certificate")]
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
