"""What the build says of itself can be checked without its code."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import yaml
from rocrate.rocrate import ROCrate


def test_the_crate_is_read_and_describes_files_that_are_there(html: Path) -> None:
    crate = ROCrate(html)
    assert crate.name
    assert crate.description
    assert crate.license
    assert crate.datePublished
    (run,) = crate.get_by_type("CreateAction")
    assert run["result"] == crate.root_dataset["hasPart"]
    assert len(run["result"]) == 3
    assert all((html / file.id).is_file() for file in run["result"])


def test_the_hash_of_the_verdicts_is_of_the_published_ones(html: Path) -> None:
    rows = json.loads((html / "verdicts.json").read_text(encoding="utf-8"))
    text = ""
    for row in rows:
        star = "★" if row["star"] else ""
        text += f"{row['claim']}\t{row['verdict']}{star}\t{row['recomputed'] != ''}\n"
    made = json.loads((html / "certificate.json").read_text(encoding="utf-8"))
    assert hashlib.sha256(text.encode()).hexdigest() == made["sha256"]["verdicts"]
    assert sum(made["verdicts"].values()) == len(rows)


def test_a_codechecker_finds_what_to_compare_and_no_check_is_claimed(html: Path) -> None:
    text = (html / "codecheck.yml").read_text(encoding="utf-8")
    assert text.startswith("---\n")
    content = yaml.safe_load(text)
    assert content["version"] == "https://codecheck.org.uk/spec/config/1.0/"
    assert all((html / item["file"]).is_file() and item["comment"] for item in content["manifest"])
    assert content["paper"]["title"]
    assert content["paper"]["authors"][0]["name"]
    assert not {"codechecker", "report", "certificate"} & set(content)
