"""What is done to an executed notebook before it is kept: the same run gives the same bytes."""

from __future__ import annotations

import base64
import io
import re

from nbformat import NotebookNode
from PIL import Image

__all__ = ["clean", "lighten", "name_cells"]

#: Size above which a palette does not suit a picture, bytes.
LARGE_DRAWING = 45_000
#: The random name that pandas gives a styled table.
_TABLE = re.compile(r'<table id="(T_[0-9a-f]{5})"')
#: Where an object lay in memory, in its default text.
_ADDRESS = re.compile(r" at 0x[0-9a-f]+(?=>)")


def name_cells(records: list[dict], notebook: NotebookNode) -> list[dict]:
    """Put a cell's lasting id in place of the number that it had when it was executed."""
    ids = {f"[{c.execution_count}]": c.id for c in notebook.cells if c.cell_type == "code"}
    return [record | {"cell": ids.get(record.get("cell", ""), "")} for record in records]


def clean(notebook: NotebookNode) -> None:
    """Remove what papermill and the kernel left that names a time, a place or a random number."""
    notebook.metadata.pop("papermill", None)
    for cell in notebook.cells:
        cell.metadata.pop("papermill", None)
        cell.metadata.pop("execution", None)
        if "injected-parameters" in cell.metadata.get("tags", []):
            cell.id = "injected-parameters"
            cell.metadata.tags.append("remove-cell")
        if "outputs" in cell:
            cell.outputs = _joined(cell.outputs)
        for number, output in enumerate(cell.get("outputs", [])):
            data = output.get("data", {})
            if "text/plain" in data:
                data["text/plain"] = _ADDRESS.sub("", data["text/plain"])
            for name in _TABLE.findall(data.get("text/html", "")):
                data["text/html"] = data["text/html"].replace(name, f"T_{cell.id}_{number}")


def _joined(outputs: list[NotebookNode]) -> list[NotebookNode]:
    """Join what a cell printed in a row: how it was parted into messages depends on time."""
    joined: list[NotebookNode] = []
    for output in outputs:
        last = joined[-1] if joined else None
        if last and output.output_type == last.output_type == "stream" and output.name == last.name:
            last.text += output.text
        else:
            joined.append(output)
    return joined


def lighten(notebook: NotebookNode) -> None:
    """Store the pictures small: drawings with a palette, photographs and noise as JPEG."""
    for output in (o for cell in notebook.cells for o in cell.get("outputs", [])):
        data = output.get("data", {})
        if "image/png" not in data:
            continue
        picture = Image.open(io.BytesIO(base64.b64decode(data["image/png"]))).convert("RGB")
        drawing = io.BytesIO()
        palette = picture.quantize(64, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
        palette.save(drawing, "PNG", optimize=True)
        photograph = io.BytesIO()
        picture.save(photograph, "JPEG", quality=75, optimize=True)
        if drawing.tell() > LARGE_DRAWING and photograph.tell() < drawing.tell():
            del data["image/png"]
            data["image/jpeg"] = base64.b64encode(photograph.getvalue()).decode()
        else:
            data["image/png"] = base64.b64encode(drawing.getvalue()).decode()
