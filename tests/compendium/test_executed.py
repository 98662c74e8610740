"""What is kept of an executed notebook: its outputs as they are, and nothing of papermill."""

from __future__ import annotations

from nbformat.v4 import new_code_cell, new_notebook, new_output

from compendium.executed import clean


def test_outputs_stay_and_traces_of_papermill_go() -> None:
    pictures = {"image/png": "iVBORw0KGgo=", "image/svg+xml": "<svg/>"}
    drawn = new_code_cell(outputs=[new_output("display_data", data=pictures)])
    drawn.metadata |= {"papermill": {"duration": 1.0}, "execution": {}}
    injected = new_code_cell(metadata={"tags": ["injected-parameters"]})
    marked = new_code_cell(metadata={"tags": ["papermill-error-cell-tag"]})
    notebook = new_notebook(cells=[injected, marked, drawn], metadata={"papermill": {}})
    clean(notebook)
    assert "papermill" not in notebook.metadata
    assert notebook.cells == [injected, drawn]
    assert injected.metadata.tags == ["injected-parameters", "remove-cell"]
    assert drawn.metadata == {}
    assert drawn.outputs[0].data == pictures
