"""What the build says of itself can be checked without its code."""

import hashlib
import json
from pathlib import Path

from rocrate.rocrate import ROCrate


def test_ro_crate_describes_existing_files(html: Path) -> None:
    crate = ROCrate(html)
    assert all((crate.name, crate.description, crate.license, crate.datePublished))
    (run,) = crate.get_by_type("CreateAction")
    assert len(run["result"]) == 3
    assert all((html / file.id).is_file() for file in run["result"])


def test_certificate_has_hash_of_published_verdicts(html: Path) -> None:
    rows = json.loads((html / "verdicts.json").read_text(encoding="utf-8"))
    text = "".join(f"{r['claim']}\t{r['verdict']}\t{r['recomputed'] != ''}\n" for r in rows)
    made = json.loads((html / "certificate.json").read_text(encoding="utf-8"))
    assert hashlib.sha256(text.encode()).hexdigest() == made["sha256"]["verdicts"]
    assert sum(made["verdicts"].values()) == len(rows)
