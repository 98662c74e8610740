"""Run notebooks in a fresh clone under what other machines have and do; show what is reported.

``python .ci/hostile.py`` tries every case, ``--quick`` those of a few seconds, and a word those
whose names hold it. A line a case says what the command answered. The exit status is 1 if a case
ends otherwise than it should.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from time import monotonic, sleep

import nbformat
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

ROOT = Path(__file__).resolve().parent.parent
CASES: dict[str, Callable[[Path], str]] = {}
SLOW: set[str] = set()
DRAWS = """
import matplotlib.pyplot as plt
from compendium.figures import show, use_style
use_style()
plt.imshow([[0, 1], [2, 3]])
plt.title("$x^2$")
show("fig-small")
"""


def case(function: Callable[[Path], str]) -> Callable[[Path], str]:
    CASES[function.__name__] = function
    return function


def slow(function: Callable[[Path], str]) -> Callable[[Path], str]:
    SLOW.add(function.__name__)
    return case(function)


def plant(clone: Path, source: str, name: str = "01_introduction") -> None:
    """Replace a notebook by a short one that has its labels, to which other pages refer."""
    file = clone / "notebooks" / f"{name}.ipynb"
    text = "\n".join(cell.source for cell in nbformat.read(file, as_version=4).cells)
    labels = re.findall(r"^\(.+\)=$", text, re.MULTILINE)
    cells = [
        new_markdown_cell("\n".join([*labels, "# 1 Introduction"]), id="title"),
        new_code_cell('record = ""', id="parameters", metadata={"tags": ["parameters"]}),
        new_code_cell(source, id="planted"),
    ]
    spec = {"name": "python3", "display_name": "Python 3", "language": "python"}
    notebook = new_notebook(cells=cells, metadata={"kernelspec": spec})
    nbformat.write(notebook, file)


def run(
    clone: Path, *arguments: str, env: Mapping[str, str] | None = None, before: str = ""
) -> subprocess.CompletedProcess[str]:
    """Run the notebooks; `before` is what a shell does first."""
    command = f'{before} exec "$0" "$@"'
    return subprocess.run(
        ["bash", "-c", command, sys.executable, "-m", "compendium.run", *arguments],
        cwd=clone,
        env=os.environ | (env or {}),
        capture_output=True,
        text=True,
        check=False,
    )


def status(clone: Path, name: str = "01_introduction") -> dict:
    return json.loads((clone / "build" / "status" / f"{name}.json").read_text("utf-8"))


def is_failure(clone: Path, done: subprocess.CompletedProcess[str], words: str) -> str:
    """Require that a failure is told now, with its reason, and later; return the line of now."""
    later = run(clone, "--failures")
    assert (done.returncode, later.returncode) == (1, 1), (done, later)
    assert words in done.stderr, done
    assert "01_introduction: " in later.stderr, later
    return done.stderr.splitlines()[0].strip()


@case
def kernel_is_killed(clone: Path) -> str:
    plant(clone, "import os; os.kill(os.getpid(), 9)")
    return is_failure(clone, run(clone, "01"), "Kernel died")


@case
def disk_is_full(clone: Path) -> str:
    plant(clone, "print('x' * 200_000)")
    done = run(clone, "01", before="ulimit -f 60;")  # blocks of 1024 bytes
    return is_failure(clone, done, "File too large")


@case
def kernel_cannot_start(clone: Path) -> str:
    plant(clone, "1")
    (clone / "broken").mkdir()
    (clone / "broken" / "ipykernel_launcher.py").write_text("raise SystemExit('broken')")
    done = run(clone, "01", env={"PYTHONPATH": str(clone / "broken")})
    assert "broken" in (clone / "build" / "logs" / "01_introduction.txt").read_text()
    return is_failure(clone, done, "Kernel died before replying")


@case
def run_is_killed(clone: Path) -> str:
    plant(clone, "open('begun', 'w').close(); import time; time.sleep(60)")
    command = [sys.executable, "-m", "compendium.run", "01"]
    with subprocess.Popen(command, cwd=clone, stderr=subprocess.DEVNULL) as running:
        wait_for(clone / "begun")
        running.kill()
    done = run(clone, "--failures")
    assert done.returncode == 1
    assert "01_introduction: FAILED: its run did not end" in done.stderr, done
    return done.stderr.splitlines()[1].strip()


@case
def signals_reach_the_kernel(clone: Path) -> str:
    for number in (signal.SIGINT, signal.SIGTERM):
        plant(
            clone,
            "import time, pathlib\npathlib.Path('begun').touch()\ntry:\n    time.sleep(60)\n"
            "except KeyboardInterrupt:\n    time.sleep(1)\n    pathlib.Path('stopped').touch()",
        )
        command = [sys.executable, "-m", "compendium.run", "01", "-p", "record", ""]
        script = "import signal, os, sys; signal.signal(2, signal.default_int_handler); "
        script += "os.execv(sys.argv[1], sys.argv[1:])"
        with subprocess.Popen(
            [sys.executable, "-c", script, *command], cwd=clone, stdout=subprocess.DEVNULL
        ) as running:
            wait_for(clone / "begun")
            running.send_signal(number)
        assert running.returncode == 130, running.returncode
        for name in ("stopped", "begun"):
            (clone / name).unlink()
    return "the notebook stopped its stage before the command ended, with 130"


def wait_for(path: Path) -> None:
    end = monotonic() + 60
    while not path.exists():
        assert monotonic() < end, f"{path.name} never came"
        sleep(0.05)


@case
def asserts_under_optimize(clone: Path) -> str:
    plant(clone, "assert False, 'planted'")
    return is_failure(clone, run(clone, "01", env={"PYTHONOPTIMIZE": "2"}), "planted")


@case
def user_has_kernels_profiles_and_styles(clone: Path) -> str:
    home = clone / "home"
    spec = home / ".local/share/jupyter/kernels/python3/kernel.json"
    startup = home / ".ipython/profile_default/startup/00.py"
    style = home / ".config/matplotlib/matplotlibrc"
    for file, text in (
        (spec, json.dumps({"argv": ["false"], "display_name": "mine", "language": "python"})),
        (startup, "raise SystemExit"),
        (style, "image.origin: lower\ntext.usetex: True\naxes.facecolor: red\n"),
    ):
        file.parent.mkdir(parents=True)
        file.write_text(text)
    plant(clone, DRAWS)
    pictures = []
    for env in ({}, {"HOME": str(home), "MATPLOTLIBRC": str(style), "MPLBACKEND": "TkAgg"}):
        assert run(clone, "01", "--force", env=env).returncode == 0
        made = nbformat.read(clone / "build/notebooks/01_introduction.ipynb", as_version=4)
        pictures.append(made.cells[-1].outputs[0].data["image/svg+xml"])
    assert pictures[0] == pictures[1]
    return f"the same picture, drawn by {status(clone)['interpreter']}"


@case
def home_is_missing(clone: Path) -> str:
    plant(clone, DRAWS)
    done = run(clone, "01", env={"HOME": "/nonexistent"})
    made = nbformat.read(clone / "build/notebooks/01_introduction.ipynb", as_version=4)
    outputs = [one.output_type for one in made.cells[-1].outputs]
    assert (done.returncode, outputs) == (0, ["display_data"]), (done, outputs)
    return done.stdout.strip()


@case
def shared_memory_is_read_only(clone: Path) -> str:
    plant(clone, "1")
    mounts = 'unshare --mount sh -c \'mount -t tmpfs -o ro tmpfs /dev/shm && exec "$0" "$@"\''
    command = ["bash", "-c", f'{mounts} "$0" "$@"', sys.executable, "-m", "compendium.run", "01"]
    if subprocess.run(["bash", "-c", f"{mounts} true"], capture_output=True).returncode:
        return "not tried, since this user may not mount"
    done = subprocess.run(command, cwd=clone, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done
    return done.stdout.strip()


@case
def notebook_is_renamed(clone: Path) -> str:
    plant(clone, DRAWS)
    assert run(clone, "01").returncode == 0
    folder = clone / "notebooks"
    (folder / "01_introduction.ipynb").rename(folder / "01_other.ipynb")
    assert run(clone, "01").returncode == 0
    assert not list((clone / "build").glob("*/01_introduction*"))
    return "nothing is left of the old name"


@case
def data_of_figures_are_gone(clone: Path) -> str:
    plant(clone, DRAWS)
    assert run(clone, "01").returncode == 0
    assert "up to date" in run(clone, "01").stdout
    shutil.rmtree(clone / "build" / "figures")
    done = run(clone, "01")
    assert "up to date" not in done.stdout
    return done.stdout.strip()


@case
def last_chapter_alone(clone: Path) -> str:
    done = run(clone, "06")
    assert done.returncode == 1
    assert "run 01_introduction 02_microsystems_and_vision" in done.stderr, done
    return done.stderr.splitlines()[-1].strip()


@case
def earlier_failure(clone: Path) -> str:
    plant(clone, "1 / 0")
    plant(clone, "1", "08_membranes")
    run(clone, "01")
    done = run(clone, "08_membranes")
    assert "01_introduction (earlier, 2" in done.stderr, done
    return done.stderr.splitlines()[-1].strip()


@case
def wrong_parameters(clone: Path) -> str:
    said = []
    for arguments, words in (
        (["-p", "force", "1", "-p", "force", "2"], "force must be given once"),
        (["-p", "outline", "missing.csv"], "outline must name a file, got missing.csv"),
        (
            ["-p", "force", "-1", "--output", "mine"],
            "force must be a finite number > 0 or None, got -1",
        ),
    ):
        done = run(clone, "07_guide_modulus", *arguments)
        assert done.returncode == 1
        assert words in done.stderr, done
        said.append(done.stderr.strip())
    assert not (clone / "build").exists()  # no kernel was started
    return "; ".join(said)


@case
def folder_was_moved(clone: Path) -> str:
    (clone / ".venv").mkdir()
    (clone / ".venv" / ".installed").write_text("/elsewhere\n")
    command = ["make", "--dry-run", "setup"]
    done = subprocess.run(command, cwd=clone, capture_output=True, text=True, check=False)
    assert "This folder was moved from /elsewhere" in done.stdout, done
    assert "-m venv" in done.stdout
    return done.stdout.splitlines()[0]


@slow
def jupyter_works_in_the_folder_of_notebooks(clone: Path) -> str:
    papermill = [sys.executable, "-m", "papermill", "--cwd", "notebooks", "--no-progress-bar"]
    for name in ("07_guide_modulus", "08_real_images"):
        command = [*papermill, f"notebooks/{name}.ipynb", "made.ipynb"]
        env = os.environ | {"PYTHONPATH": str(clone)}  # as `pip install -e .` puts it on the path
        done = subprocess.run(
            command, cwd=clone, env=env, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done
    assert not (clone / "notebooks" / "build").exists()
    assert (clone / "build" / "guides" / "modulus" / "modulus.csv").exists()
    return "two notebooks ran, and left nothing among the notebooks"


@slow
def servoing_is_interrupted(clone: Path) -> str:
    """The demo microscope, with frames that take a second each."""
    if find_spec("pymmcore_plus") is None:
        return "not tried, since Micro-Manager's engine is not installed (make extras)"
    import pymmcore_plus

    demo = Path(pymmcore_plus.find_micromanager() or "") / "MMConfig_demo.cfg"
    more = "\nProperty,Camera,Mode,Fluorescent Beads\nProperty,Camera,Exposure,1000\n"
    (clone / "slow.cfg").write_text(demo.read_text(encoding="utf-8") + more, encoding="utf-8")
    values = {"configuration": "slow.cfg", "box": "[220, 220, 64, 64]", "travel": "150"}
    values |= {"targets": "[[30, 0], [0, 0]]", "out": "results"}
    words = [word for name, value in values.items() for word in ("-p", name, value)]
    command = [sys.executable, "-m", "compendium.run", "07_guide_servoing", *words]
    with subprocess.Popen(command, cwd=clone, stdout=subprocess.DEVNULL) as running:
        wait_for(clone / "results")  # which is made before the kernel starts
        (clone / "results").rmdir()
        wait_for(clone / "results")  # and by the guide, before it steers
        sleep(8)
        running.send_signal(signal.SIGTERM)
        start = monotonic()
    assert running.returncode == 130, running.returncode
    log = (clone / "results" / "log.csv").read_text(encoding="utf-8").splitlines()
    assert "interrupted by the user" in log[-1], log[-1]
    return f"stopped and logged {len(log) - 1} frames within {monotonic() - start:.0f} s"


@slow
def archive_without_git(clone: Path) -> str:
    shutil.rmtree(clone / ".git")
    done = run(clone, "01")
    assert done.returncode == 0, done
    return done.stdout.strip()


@slow
def book_without_notebooks(clone: Path) -> str:
    command = [sys.executable, "-m", "compendium.book"]
    plant(clone, "1 / 0")
    run(clone, "01")
    done = subprocess.run(command, cwd=clone, capture_output=True, text=True, check=False)
    assert done.returncode == 1, done
    assert "05_experimental_results: it was not run" in done.stderr, done
    html = clone / "build" / "html"
    failed = (html / "notebooks" / "01_introduction.html").read_text("utf-8")
    assert "FAILED in cell planted: ZeroDivisionError" in failed
    assert status(clone)["when"] in failed
    for page in ("intro", "claims", "notebooks/05_experimental_results"):
        assert "not computed in this build" in (html / f"{page}.html").read_text("utf-8"), page
    return "every page is there; those of the notebooks say that they were not run"


def main(wanted: list[str]) -> int:
    failed = []
    for name, function in CASES.items():
        if ("--quick" in wanted and name in SLOW) or not all(
            word in name for word in wanted if word != "--quick"
        ):
            continue
        with tempfile.TemporaryDirectory() as folder:
            clone = Path(folder) / "a clone"
            subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
            start = monotonic()
            try:
                print(f"{name.replace('_', ' ')}: {function(clone)}", flush=True)
            except Exception:
                failed.append(name)
                print(f"{name.replace('_', ' ')}: WRONG\n{traceback.format_exc()}", flush=True)
            print(f"    {monotonic() - start:.0f} s", flush=True)
    print(f"Wrong: {', '.join(failed)}" if failed else "All as it should be")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
