"""A reader's text becomes a value of the parameter's type, or one line says why it cannot."""

import re

import pytest

from compendium.parameters import describe, read_values
from tests.compendium.test_run import write_notebook

CELL = """record = ""  # not used here
stack = ""  # input: the frames, or "demo"
spacing = 25.0  # µm, ≠ 0, between frames
size = 3.9  # µm/px, > 0
spread = 0.0  # µm, ≥ 0, standard deviation
start = -50.0  # µm
box = [30, 40, 40, 40]  # px
targets = [[40.0, -30.0], [0.0, 0.0]]  # px
seed = 1  # of the noise
radius = None  # µm, > 0; or an outline
out = "build/guides/focus"  # folder"""


@pytest.fixture
def notebook(tmp_path, monkeypatch):
    """A notebook, seen from another folder."""
    (tmp_path / "project" / "notebooks").mkdir(parents=True)
    write_notebook(tmp_path / "project", "07_guide", "other = 1", CELL)
    (tmp_path / "reader").mkdir()
    (tmp_path / "reader" / "a.png").touch()
    monkeypatch.chdir(tmp_path / "reader")
    return tmp_path / "project" / "notebooks" / "07_guide.ipynb"


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("spacing", "1e1", 10.0),
        ("spread", "0", 0.0),
        ("box", "[1, 2,3,4]", [1, 2, 3, 4]),
        ("targets", "[[40, -30], [-35, -25], [0, 0]]", [[40.0, -30.0], [-35.0, -25.0], [0.0, 0.0]]),
        ("radius", "None", None),
        ("record", "null", "null"),
        ("stack", "demo", "demo"),
        ("stack", "a.png", "a.png"),
    ],
)
def test_text_is_converted_to_type_of_parameter(notebook, name, text, value):
    found = read_values(notebook, [(name, text)])[name]
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("spacing", "1e1x", "spacing must be a finite number ≠ 0, got 1e1x"),
        ("spacing", "2,5", "spacing must be a finite number ≠ 0, got 2,5: write a decimal point"),
        ("spacing", "0", "spacing must be a finite number ≠ 0, got 0"),
        ("size", "0", "size must be a finite number > 0, got 0"),
        ("radius", "0", "radius must be a finite number > 0 or None, got 0"),
        ("size", "None", "size must be a finite number > 0, got None"),
        ("size", "-1", "size must be a finite number > 0, got -1"),
        ("spread", "-1e-9", "spread must be a finite number ≥ 0, got -1e-9"),
        ("seed", "1.5", "seed must be a whole number, got 1.5"),
        ("seed", "True", "seed must be a whole number, got True"),
        ("radius", "wide", "radius must be a finite number > 0 or None, got wide"),
        ("box", "[1,2,3]", r"box must be 4 numbers in brackets, such as \[30, 40, 40, 40\], got "),
        ("targets", "[[40, -30], [1]]", "targets must be lists of 2 numbers in brackets, such as "),
        ("stack", "mine.tif", "stack must name a file, got mine.tif: no such file"),
        ("out", "a.png", "out must be a folder that can be written to, got a.png: File exists"),
        ("spacin", "1", "07_guide has no parameter spacin; did you mean spacing?"),
        ("zzz", "1", "07_guide has no parameter zzz; it has record, stack"),
    ],
)
def test_wrong_text_raises_one_line(notebook, name, text, message):
    with pytest.raises(ValueError, match=f"^{message.replace('?', '[?]')}") as caught:
        read_values(notebook, [(name, text)])
    assert "\n" not in str(caught.value)


def test_table_of_parameters_has_default_accepted_values_and_meaning_of_each(notebook, monkeypatch):
    monkeypatch.setattr("compendium.parameters.ROOT", notebook.parents[1])
    table = describe("07_guide")
    assert [*table.index] == re.findall(r"^(\w+) = ", CELL, re.M)[1:]  # without the record
    assert [*table.loc["spacing"]] == ["25.0", "a finite number ≠ 0", "µm, between frames"]
    assert [*table.loc["radius"]] == ["None", "a finite number > 0 or None", "µm; or an outline"]
    assert [*table.loc["seed"]] == ["1", "a whole number", "of the noise"]
    assert [*table.loc["out"]] == ['"build/guides/focus"', "a text", "folder"]
