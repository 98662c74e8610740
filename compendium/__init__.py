"""Code of this thesis alone: claims, verdicts, experiments, figures, and what runs it all."""

from pathlib import Path

#: The project's folder, in which notebooks, data and what is built lie.
ROOT = Path(__file__).resolve().parent.parent
#: What the book shows for a value or a figure whose notebook failed or was not run.
MISSING = "not computed in this build"
