"""What is kept of an executed notebook: small pictures, and nothing of papermill."""

from __future__ import annotations

import base64
import io

import numpy as np
from nbformat.v4 import new_code_cell, new_notebook, new_output
from PIL import Image

from compendium.executed import clean


def test_drawings_get_a_palette_and_photographs_become_jpeg() -> None:
    rng = np.random.default_rng(0)
    ramp = np.linspace(40, 200, 300)[:, None] * [1.0, 0.8, 0.6]
    scene = (ramp + rng.normal(0, 4, (300, 300, 3))).astype(np.uint8)
    drawing = np.full((200, 300, 3), 255, np.uint8)
    drawing[50:60] = (200, 30, 30)
    cells = []
    for picture in (scene, drawing):
        buffer = io.BytesIO()
        Image.fromarray(picture).save(buffer, "PNG", compress_level=0)
        data = {"image/png": base64.b64encode(buffer.getvalue()).decode()}
        cells.append(new_code_cell(outputs=[new_output("display_data", data=data)]))
    notebook = new_notebook(cells=cells)
    clean(notebook)
    photograph, drawn = (cell.outputs[0].data for cell in notebook.cells)
    assert list(photograph) == ["image/jpeg"]
    assert len(photograph["image/jpeg"]) < scene.size / 2
    assert list(drawn) == ["image/png"]
    assert len(drawn["image/png"]) < drawing.size / 100
    kept = Image.open(io.BytesIO(base64.b64decode(drawn["image/png"]))).convert("RGB")
    np.testing.assert_array_equal(np.asarray(kept), drawing)
