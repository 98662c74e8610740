"""Write what a reader needs to check one build of the book against another.

``compendium.book`` runs it before the pages are rendered; what it leaves in ``build/certificate``
lies beside the pages afterwards:

- ``verdicts.json`` and ``scorecard.csv``: every printed number with its verdict,
- ``certificate.json``: commit, machine, versions, times and hashes, which the page shows,
- ``codecheck.yml``: a copy of that of the project, which an independent codechecker completes,
- ``ro-crate-metadata.json``: the same for programs, as https://w3id.org/ro/crate describes it.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import subprocess
import sys
from collections import Counter
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import pandas as pd
import yaml
from rocrate.model.contextentity import ContextEntity
from rocrate.model.person import Person
from rocrate.rocrate import ROCrate

from compendium import ledger
from microlib import __version__

ROOT = Path(__file__).resolve().parents[1]
BUILD = ROOT / "build"
PACKAGES = ("numpy", "scipy", "scikit-image", "opencv-python-headless", "pandas", "matplotlib")
COMMAND = "make book"
THESIS = "3D Reconstruction, Classification and Mechanical Characterization of Microstructures"
AUTHOR = "Muhammet Ali Hocaoğlu"
SOURCE = "Master's thesis, Sabancı University, 2008"
#: What the build writes, each with a comment.
MADE = {
    Path(entry["file"]).name: entry["comment"]
    for entry in yaml.safe_load((ROOT / "codecheck.yml").read_text(encoding="utf-8"))["manifest"]
}


def git(*arguments: str) -> str:
    """Return what git says; nothing where the folder is not a repository."""
    command = ["git", "-C", str(ROOT), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()


def processor() -> str:
    """Return the processor's name, where the system tells it."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def hash_of(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def contents(folder: Path, pattern: str) -> str:
    """Return the paths and texts of files, in the order of their paths."""
    texts = {p.relative_to(folder).as_posix(): p.read_text("utf-8") for p in folder.glob(pattern)}
    return "".join(f"{name}\n{texts[name]}" for name in sorted(texts))


def gather(scores: pd.DataFrame) -> dict:
    """Return the certificate: what was run, where, for how long, and the hashes of what came out.

    Parameters
    ----------
    scores : pandas.DataFrame
        The table of `compendium.ledger.scorecard`.

    Returns
    -------
    dict
        ``sha256`` holds the hash of ``verdicts``, the lines *claim, verdict, recorded*, which is
        the same on every processor; of ``figures``, the numbers behind the figures, which is the
        same on one machine; and of what went in.
    """
    runs = [json.loads(path.read_text("utf-8")) for path in sorted(BUILD.glob("status/*.json"))]
    words = [f"{row.claim}\t{row.verdict}\t{bool(row.recomputed)}\n" for row in scores.itertuples()]
    return {
        "commit": git("rev-parse", "HEAD") or "unknown: no repository",
        "committed": git("log", "-1", "--format=%cI"),
        "changed": bool(git("status", "--porcelain", "--untracked-files=no")),
        "version": __version__,
        "command": COMMAND,
        "built": datetime.now(UTC).isoformat(timespec="seconds"),
        "system": platform.platform(),
        "processor": f"{processor()}, {os.cpu_count()} cores",
        "versions": {
            "python": platform.python_version(),
            **{name: version(name) for name in PACKAGES},
        },
        "notebooks": [
            {part: run[part] for part in ("notebook", "interpreter", "seconds", "checks", "failed")}
            for run in runs
        ],
        "verdicts": dict(Counter(scores["verdict"])),
        "sha256": {
            "verdicts": hash_of("".join(words)),
            "figures": hash_of(contents(BUILD, "figures/*.csv")),
            "microlib": hash_of(contents(ROOT / "microlib", "**/*.py")),
            "data/thesis": hash_of(contents(ROOT / "data/thesis", "*.toml")),
            "environment.txt": hash_of(contents(ROOT, "environment.txt")),
        },
    }


def crate(certificate: dict) -> ROCrate:
    """Return the description of the built book as a research object."""
    result = ROCrate()
    result.name = "3-D Microstructures, an executable thesis"
    result.description = f"Printed numbers compared with recomputed numbers: {THESIS} ({SOURCE})."
    result.datePublished = datetime.fromisoformat(certificate["built"])
    result.license = "https://spdx.org/licenses/CC-BY-4.0"
    author = result.add(Person(result, "#author", {"name": AUTHOR}))
    thesis = {"@type": "Thesis", "name": THESIS, "author": author, "datePublished": "2008"}
    software = {
        "@type": "SoftwareSourceCode",
        "name": "microlib and the notebooks",
        "version": f"{__version__}, commit {certificate['commit']}",
        "license": "https://spdx.org/licenses/MIT",
    }
    instrument, about = (
        result.add(ContextEntity(result, name, properties))
        for name, properties in (("#software", software), ("#thesis", thesis))
    )
    files = [
        result.add_file(dest_path=name, properties={"name": name, "description": comment})
        for name, comment in MADE.items()
    ]
    run = {
        "@type": "CreateAction",
        "name": f"{COMMAND} on {certificate['processor']}, {certificate['system']}",
        "endTime": certificate["built"],
    }
    action = result.add(ContextEntity(result, "#run", run))
    action["instrument"], action["object"], action["result"] = instrument, about, files
    result.root_dataset["about"], result.root_dataset["mentions"] = about, action
    return result


def tables(certificate: dict) -> str:
    """Return the certificate as the tables of its page."""
    names = ("commit", "committed", "version", "command", "built", "system", "processor")
    facts = {name.capitalize(): certificate[name] for name in names}
    facts["Commit"] += ", with changes" * certificate["changed"]
    facts["Verdicts"] = ", ".join(f"{n} {word}" for word, n in certificate["verdicts"].items())
    facts |= {f"Version of {name}": text for name, text in certificate["versions"].items()}
    runs = [
        [run["notebook"], run["interpreter"], run["seconds"], run["failed"] or run["checks"]]
        for run in certificate["notebooks"]
    ]
    shown = {
        ("This build", "Value"): facts.items(),
        ("SHA-256 of", "Value"): certificate["sha256"].items(),
        ("Notebook", "Interpreter", "Run time (s)", "Checks passed"): runs,
    }
    texts = [
        pd.DataFrame(rows, columns=[*head]).to_html(
            index=False, border=0, classes="table", justify="left"
        )
        for head, rows in shown.items()
    ]
    # As the theme writes tables, which can then be scrolled on a phone.
    return "".join(f'<div class="pst-scrollable-table-container">{text}</div>\n' for text in texts)


def main(folder: Path) -> None:
    """Write all of it into a folder, and the tables of its page beside it."""
    folder.mkdir(parents=True, exist_ok=True)
    scores = ledger.scorecard(BUILD / "claims")
    certificate = gather(scores)
    texts = {
        "scorecard.csv": scores.to_csv(index=False),
        "verdicts.json": scores.to_json(orient="records", force_ascii=False, indent=1),
        "certificate.json": json.dumps(certificate, indent=1, ensure_ascii=False) + "\n",
        "codecheck.yml": (ROOT / "codecheck.yml").read_text(encoding="utf-8"),
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    crate(certificate).metadata.write(folder)
    folder.with_suffix(".html").write_text(tables(certificate), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
