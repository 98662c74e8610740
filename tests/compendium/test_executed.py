"""What is kept of an executed notebook: small pictures, and no random name, place or time."""

from __future__ import annotations

import base64
import io

import numpy as np
import pandas as pd
from nbformat.v4 import new_code_cell, new_notebook, new_output
from PIL import Image

from compendium.executed import clean, lighten, name_cells


def shown(value: object, **data: str) -> object:
    return new_output("execute_result", data={"text/plain": repr(value), **data})


def test_random_names_and_addresses_go() -> None:
    """Two styled tables in one cell keep apart; their rows and style sheet keep together."""
    texts = []
    for _ in range(2):
        tables = [pd.DataFrame({"x": [1]}).style.format(precision=1) for _ in range(2)]
        outputs = [shown(table, **{"text/html": table.to_html()}) for table in tables]
        assert outputs[0].data["text/html"] != outputs[1].data["text/html"]
        injected = new_code_cell("x = 1", metadata={"tags": ["injected-parameters"]})
        notebook = new_notebook(cells=[injected, new_code_cell(outputs=outputs, id="table")])
        clean(notebook)
        texts.append(notebook)
    assert texts[0] == texts[1]
    first, second = texts[0].cells[1].outputs
    assert first.data["text/plain"] == repr(tables[0]).partition(" at 0x")[0] + ">"
    assert '<table id="T_table_0"' in first.data["text/html"]
    assert 'id="T_table_0_row0_col0"' in first.data["text/html"]
    assert "T_table_0" not in second.data["text/html"]


def test_times_and_tools_go() -> None:
    cell = new_code_cell(metadata={"papermill": {"duration": 1.0}, "execution": {"x": "now"}})
    notebook = new_notebook(cells=[cell], metadata={"papermill": {}, "title": "kept"})
    clean(notebook)
    assert notebook.metadata == {"title": "kept"}
    assert cell.metadata == {}


def test_what_is_printed_in_a_row_is_one_output() -> None:
    """However the kernel parted it: errors and results in between part it, too."""

    def printed(*texts: str) -> list[object]:
        return [new_output("stream", name="stdout", text=text) for text in texts]

    kept = []
    for parts in (["a\n", "b\n", "c\n"], ["a\nb\n", "c\n"]):
        error = new_output("stream", name="stderr", text="late\n")
        outputs = [*printed(*parts), error, *printed("d\n"), shown(3), *printed("e\n")]
        notebook = new_notebook(cells=[new_code_cell(outputs=outputs, id="prints")])
        clean(notebook)
        kept.append(notebook)
    assert kept[0] == kept[1]
    texts = [output.get("text") for output in kept[0].cells[0].outputs]
    assert texts == ["a\nb\nc\n", "late\n", "d\n", None, "e\n"]


def test_a_record_names_its_cell_for_good() -> None:
    notebook = new_notebook(cells=[new_code_cell(id="one", execution_count=7)])
    records = name_cells([{"id": "a", "cell": "[7]"}, {"id": "b", "cell": "[8]"}], notebook)
    assert records == [{"id": "a", "cell": "one"}, {"id": "b", "cell": ""}]


def test_drawings_get_a_palette_and_photographs_become_jpeg() -> None:
    rng = np.random.default_rng(0)
    ramp = np.linspace(40, 200, 300)[:, None] * [1.0, 0.8, 0.6]
    scene = (ramp + rng.normal(0, 4, (300, 300, 3))).astype(np.uint8)
    drawing = np.full((200, 300, 3), 255, np.uint8)
    drawing[50:60] = (200, 30, 30)
    cells, sizes = [], []
    for picture in (scene, drawing, scene[:60, :60]):
        buffer = io.BytesIO()
        Image.fromarray(picture).save(buffer, "PNG", compress_level=0)
        data = {"image/png": base64.b64encode(buffer.getvalue()).decode()}
        sizes.append(len(data["image/png"]))
        cells.append(new_code_cell(outputs=[new_output("display_data", data=data)]))
    notebook = new_notebook(cells=cells)
    lighten(notebook)
    photograph, drawn, small = (cell.outputs[0].data for cell in notebook.cells)
    assert list(photograph) == ["image/jpeg"]
    assert len(photograph["image/jpeg"]) < sizes[0] / 2
    assert list(drawn) == list(small) == ["image/png"]
    assert len(drawn["image/png"]) < sizes[1] / 100
    kept = Image.open(io.BytesIO(base64.b64decode(drawn["image/png"]))).convert("RGB")
    np.testing.assert_array_equal(np.asarray(kept), drawing)
