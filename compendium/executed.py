"""What is done to an executed notebook before it is kept."""

from __future__ import annotations

import base64
import io

from nbformat import NotebookNode
from PIL import Image

#: Size above which a palette does not suit a picture, bytes.
LARGE_DRAWING = 45_000


def error_cell(notebook: NotebookNode) -> str:
    """Return the id of the cell that failed; empty if none did."""
    outputs = ((cell.id, output) for cell in notebook.cells for output in cell.get("outputs", []))
    return next((name for name, output in outputs if output.output_type == "error"), "")


def clean(notebook: NotebookNode) -> None:
    """Remove what papermill adds, hide the parameters that it injected, and store pictures small:
    drawings with a palette, photographs and noise as JPEG."""
    notebook.metadata.pop("papermill", None)
    marked = "papermill-error-cell-tag"
    notebook.cells = [c for c in notebook.cells if marked not in c.metadata.get("tags", [])]
    for cell in notebook.cells:
        cell.metadata.pop("papermill", None)
        cell.metadata.pop("execution", None)
        if "injected-parameters" in cell.metadata.get("tags", []):
            cell.id = "injected-parameters"
            cell.metadata.tags.append("remove-cell")
        for output in cell.get("outputs", []):
            if "image/png" in output.get("data", {}):
                output.data |= _small(output.data.pop("image/png"))


def _small(png: str) -> dict[str, str]:
    picture = Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB")
    drawing, photograph = io.BytesIO(), io.BytesIO()
    palette = picture.quantize(64, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    palette.save(drawing, "PNG", optimize=True)
    picture.save(photograph, "JPEG", quality=75, optimize=True)
    if drawing.tell() > LARGE_DRAWING and photograph.tell() < drawing.tell():
        return {"image/jpeg": base64.b64encode(photograph.getvalue()).decode()}
    return {"image/png": base64.b64encode(drawing.getvalue()).decode()}
