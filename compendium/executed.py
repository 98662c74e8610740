"""What is done to an executed notebook before it is kept."""

from __future__ import annotations

from nbformat import NotebookNode


def error_cell(notebook: NotebookNode) -> str:
    """Return the id of the cell that failed; empty if none did."""
    outputs = ((cell.id, output) for cell in notebook.cells for output in cell.get("outputs", []))
    return next((name for name, output in outputs if output.output_type == "error"), "")


def clean(notebook: NotebookNode) -> None:
    """Remove what papermill adds, and hide the parameters that it injected."""
    notebook.metadata.pop("papermill", None)
    marked = "papermill-error-cell-tag"
    notebook.cells = [c for c in notebook.cells if marked not in c.metadata.get("tags", [])]
    for cell in notebook.cells:
        cell.metadata.pop("papermill", None)
        cell.metadata.pop("execution", None)
        if "injected-parameters" in cell.metadata.get("tags", []):
            cell.id = "injected-parameters"
            cell.metadata.tags.append("remove-cell")
