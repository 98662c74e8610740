"""What `pip install .` installs, and on which versions of what."""

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version
from setuptools import find_packages

import microlib

ROOT = Path(__file__).resolve().parent.parent
#: What is code, and what Python keeps of it.
CODE = {".py", ".pyc"}
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def test_the_library_alone_is_installed_and_all_of_it():
    found = find_packages(str(ROOT), **PROJECT["tool"]["setuptools"]["packages"]["find"])
    folders = {path.parent.relative_to(ROOT) for path in (ROOT / "microlib").rglob("*.py")}
    assert set(found) == {".".join(folder.parts) for folder in folders}
    data = PROJECT["tool"]["setuptools"]["package-data"]
    listed = {
        ROOT.joinpath(*room.split("."), name) for room, names in data.items() for name in names
    }
    own = {p for p in (ROOT / "microlib").rglob("*") if p.is_file() and p.suffix not in CODE}
    assert own == listed


def test_each_lower_bound_is_the_version_that_was_tested():
    lines = (ROOT / "tests" / "oldest.txt").read_text(encoding="utf-8").splitlines()
    tested = dict(line.split("==") for line in lines if line and not line.startswith("#"))
    optional = PROJECT["project"]["optional-dependencies"]
    for text in [*PROJECT["project"]["dependencies"], *optional["opencv"]]:
        need = Requirement(text)
        (bound,) = need.specifier
        assert bound.operator == ">=", text
        assert Version(bound.version) == Version(tested[need.name]), text


def test_the_version_is_the_same_everywhere():
    stated = PROJECT["project"]["version"]
    assert microlib.__version__ == stated
    assert f"\nversion: {stated}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"version = {{{stated}}}" in (ROOT / "book" / "intro.md").read_text(encoding="utf-8")
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.findall(r"^## \[?([\d.]+)", changes, flags=re.M)[0] == stated


def locked(name: str) -> dict[str, str]:
    text = (ROOT / name).read_text(encoding="utf-8")
    return dict(re.findall(r"^([\w.-]+)==([^ \\;]+)", text, flags=re.M))


@pytest.mark.parametrize(
    ("file", "groups"),
    [("extras.txt", ["dask", "microscope"]), ("test.txt", ["test"]), ("lab.txt", ["lab"])],
)
def test_each_lock_keeps_to_the_environment_and_has_its_groups(file, groups):
    versions, environment = locked(file), locked("environment.txt")
    assert not {n: (v, environment[n]) for n, v in versions.items() if environment.get(n, v) != v}
    for group in groups:
        for text in PROJECT["project"]["optional-dependencies"][group]:
            need = Requirement(text)
            version = (versions | environment)[need.name]
            assert need.specifier.contains(version), text
    text = (ROOT / file).read_text(encoding="utf-8")
    assert text.count("--hash=sha256:") >= len(versions)
