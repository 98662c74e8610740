"""Execute one notebook with papermill, in a kernel that is the interpreter of this process."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import traceback
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from threading import Event, Timer
from time import perf_counter
from typing import Any, ClassVar

import nbformat
import papermill
from jupyter_client.kernelspec import KernelSpec
from jupyter_client.manager import AsyncKernelManager
from jupyter_core.utils import ensure_event_loop
from nbformat import NotebookNode
from papermill.exceptions import PapermillExecutionError
from traitlets import Dict, Unicode
from traitlets.config import Config

from microlib._common import replace_file

#: Variables of the reader's own environment that would change the numbers or the figures. They are
#: removed for the kernel.
PERSONAL = (
    *("PYTHONDEVMODE", "PYTHONOPTIMIZE", "PYTHONSTARTUP", "PYTHONWARNINGS"),
    *("MATPLOTLIBRC", "MPLBACKEND"),
)
#: Length of the folder's name, bytes, up to which the name of a socket in it is short enough.
LONGEST_FOLDER = 100
interrupted = Event()


class Kernel(AsyncKernelManager):
    """This interpreter, whichever kernels, profiles and options the user's configuration has."""

    log_file = Unicode(help="File for what the kernel writes outside of the notebook.").tag(
        config=True
    )
    variables = Dict(help="Environment variables beside those of this process.").tag(config=True)
    started: ClassVar[list[Kernel]] = []

    @property
    def kernel_spec(self) -> KernelSpec:
        command = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]
        return KernelSpec(argv=command, display_name="Python 3", language="python")

    async def start_kernel(self, **options: Any) -> None:  # type: ignore[override]
        environment = {k: v for k, v in os.environ.items() if k not in PERSONAL}
        with open(self.log_file, "ab") as log:
            options |= {"stdout": log, "stderr": log, "env": environment | self.variables}
            await super().start_kernel(**options)
        self.started.append(self)


def interrupt_kernels(number: int | None = None, _: object = None) -> None:
    """Interrupt each kernel, as Ctrl-C would; no other cell starts. It is a handler of signals.

    Do it again every few seconds, since a kernel that is between two cells misses it.
    """
    if number and interrupted.is_set():
        return  # a second interrupt at once would break off what the first one began
    interrupted.set()
    for kernel in Kernel.started:
        if kernel.has_kernel:
            with suppress(ProcessLookupError):  # it has just ended
                os.killpg(kernel.provisioner.pid, signal.SIGINT)  # type: ignore[union-attr]
    again = Timer(5, interrupt_kernels)
    again.daemon = True
    again.start()


def _before_cell(**_: object) -> None:
    if interrupted.is_set():
        raise InterruptedError("interrupted")


def execute(
    source: Path,
    output: Path,
    values: Mapping[str, object],
    cwd: Path,
    *,
    log: Path,
    variables: Mapping[str, str] | None = None,
    cell_limit: float | None = None,
) -> tuple[str, bool]:
    """Execute a notebook with papermill.

    Parameters
    ----------
    source, output : pathlib.Path
        The notebook, and the executed copy, which appears at the end, whether it passed or not.
    values : mapping
        By the names of the notebook's parameters.
    cwd : pathlib.Path
        The kernel's working folder.
    log : pathlib.Path
        Text file to which the kernel's other output and a traceback of this process are appended.
    variables : mapping of str to str, optional
        More environment variables for the kernel.
    cell_limit : float, optional
        Seconds after which a cell counts as failed.

    Returns
    -------
    message : str
        One line: the seconds that it took, or what failed, in which cell.
    passed : bool
        Whether every cell ended without an error.
    """
    start, message, passed = perf_counter(), "", False
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / output.name
        # An empty folder for IPython, which keeps away a profile of the user.
        variables = {"IPYTHONDIR": f"{folder}/ipython", **(variables or {})}
        settings: dict[str, Any] = {"log_file": str(log), "variables": variables}
        settings["connection_file"] = f"{folder}/kernel.json"
        if len(os.fsencode(folder)) <= LONGEST_FOLDER:
            # Sockets in a folder of their own, as the default names of two kernels may collide.
            settings |= {"transport": "ipc", "ip": f"{folder}/k"}
        try:
            papermill.execute_notebook(
                source,
                made,
                dict(values),
                kernel_name="python3",
                language="python",
                progress_bar=False,
                execution_timeout=cell_limit,
                kernel_manager_class=Kernel,
                config=Config({"Kernel": settings}),
                resources={"metadata": {"path": str(cwd)}},
                on_cell_start=_before_cell,
            )
            message, passed = f"{perf_counter() - start:.1f} s", True
            if said := error_of(nbformat.read(made, as_version=4)):  # papermill lets them pass
                message, passed = said, False
        except PapermillExecutionError as error:
            # IPython prints the reason of a failing magic instead of raising an error.
            said = f"{error.ename}: {error.evalue}"
            message = one_line(said if error.evalue else printed_error(made) or said)
        except Exception as error:  # whatever happens to a kernel, other notebooks go on
            with log.open("a", encoding="utf-8") as file:
                traceback.print_exc(file=file)
            message = one_line(f"{type(error).__name__}: {error}".partition("\n")[0])
        finally:
            loop = ensure_event_loop()  # of this thread, which nbclient leaves open
            if not loop.is_running():  # a caller's own loop is not ours to close
                loop.close()
        try:
            notebook = nbformat.read(made, as_version=4)
        except (OSError, ValueError):  # never written, or cut off on a full disk
            notebook = nbformat.read(source, as_version=4)
        if not passed:
            message = f"FAILED{place_of_failure(notebook)}: {message}"
        clean(notebook)
        replace_file(output, lambda file: nbformat.write(notebook, file))
    return message, passed


def one_line(text: object) -> str:
    return " ".join(str(text).split())


def error_of(notebook: NotebookNode) -> str:
    """Return the error of a cell, such as that of ``sys.exit(0)``; nothing if there is none."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    errors = [output for output in outputs if output.output_type == "error"]
    return one_line(f"{errors[0].ename}: {errors[0].evalue}") if errors else ""


def printed_error(executed: Path) -> str:
    """Return the last line that a cell wrote to the error stream; nothing if none did."""
    notebook = nbformat.read(executed, as_version=4)
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    lines = [o.text.strip().splitlines() for o in outputs if o.get("name") == "stderr"]
    return lines[-1][-1] if lines and lines[-1] else ""


def place_of_failure(notebook: NotebookNode) -> str:
    """Return " in cell ID" of the last cell that began; nothing if none did."""
    begun = [c.id for c in notebook.cells if c.metadata.get("papermill", {}).get("start_time")]
    return f" in cell {begun[-1]}" if begun else ""


def clean(notebook: NotebookNode) -> None:
    """Remove what papermill adds, hide the parameters that it injected, and fold the checks."""
    notebook.metadata.pop("papermill", None)
    marked = "papermill-error-cell-tag"
    notebook.cells = [c for c in notebook.cells if marked not in c.metadata.get("tags", [])]
    for cell in notebook.cells:
        cell.metadata.pop("papermill", None)
        cell.metadata.pop("execution", None)
        if "injected-parameters" in cell.metadata.get("tags", []):
            cell.id = "injected-parameters"
            cell.metadata.tags.append("remove-cell")
        if "check" in cell.metadata.get("tags", []):
            cell.metadata.tags.append("hide-cell")
            prompts = {"code_prompt_show": f"Check: {state_of(cell)}", "code_prompt_hide": "Check"}
            cell.metadata.setdefault("mystnb", {}).update(prompts)


def state_of(cell: NotebookNode) -> str:
    """Return whether a cell passed, failed or was not run."""
    if cell.execution_count is None:
        return "not run"
    failed = any(output.output_type == "error" for output in cell.outputs)
    return "failed" if failed else "passed"
