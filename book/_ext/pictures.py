"""A small picture on the page of each main function: a figure of the book in which it is at work.

The pictures are made from the figures that the notebooks drew, when the book is built, and lead to
them.
"""

from __future__ import annotations

import io
from base64 import b64decode
from dataclasses import dataclass
from functools import cache
from html import escape
from pathlib import Path

import nbformat
from PIL import Image
from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = ROOT / "build" / "notebooks"
#: The figure on the page of each main function or class.
PICTURES = {
    "microlib.automation.acquire_depth": "fig-ch6-live",
    "microlib.automation.inject": "fig-ch6-injection",
    "microlib.calibration.calibrate": "fig-5-2",
    "microlib.calibration.detect_circles": "fig-guide-calibration",
    "microlib.curvature.hk_labels": "fig-guide-classes",
    "microlib.curvature.surface_curvature": "fig-3-4",
    "microlib.embryo.dimple_geometry": "fig-guide-dimple",
    "microlib.embryo.extract_boundary": "fig-5-17",
    "microlib.embryo.fit_dimple": "fig-5-18-rendered",
    "microlib.embryo.force_over_time": "fig-ch6-force",
    "microlib.embryo.modulus_from_image": "fig-guide-embryo",
    "microlib.focus.correct_spikes": "fig-ch3-spikes",
    "microlib.focus.depth_from_focus": "fig-guide-focus",
    "microlib.focus.sum_modified_laplacian": "fig-ch3-profile",
    "microlib.membrane.dimple_profile": "fig-ch4-profiles",
    "microlib.membrane.elastic_modulus": "fig-4-3",
    "microlib.membrane.indent_capsule": "fig-ch5-modulus",
    "microlib.membrane.indent_disc": "fig-ch4-discs",
    "microlib.membrane.indentation_force": "fig-ch4-force",
    "microlib.microscope.Microscope": "fig-2-4",
    "microlib.optics.defocus": "fig-ch3-defocus",
    "microlib.servoing.loop_poles": "fig-ch2-stability",
    "microlib.servoing.servo": "fig-guide-servoing",
    "microlib.servoing.simulate": "fig-5-4",
    "microlib.tracking.ESMTracker": "fig-guide-tracking",
    "microlib.tracking.KalmanFilter": "fig-ch2-kalman",
}
WIDTH, HEIGHT = 480, 400  # px at most; shown at two thirds of it
MOST_BYTES = 20_000


@dataclass(frozen=True)
class Figure:
    """A figure as a notebook drew it."""

    stem: str
    picture: bytes
    alt: str

    def small(self) -> Image.Image:
        image = Image.open(io.BytesIO(self.picture)).convert("RGB")
        image.thumbnail((WIDTH, HEIGHT))
        return image

    def webp(self) -> bytes:
        """Return the small picture, as well as it can be in few bytes."""
        for quality in range(80, 0, -10):
            file = io.BytesIO()
            self.small().save(file, "webp", quality=quality)
            if file.tell() <= MOST_BYTES:
                return file.getvalue()
        raise ValueError(f"a figure of {self.stem} must fit into {MOST_BYTES} bytes, does not")


@cache
def read_figures() -> dict[str, Figure]:
    """Return the figures of the executed notebooks by their names."""
    found = {}
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        for cell in nbformat.read(path, as_version=4).cells:
            shown = cell.metadata.get("mystnb", {})
            name = shown.get("figure", {}).get("name")
            for output in cell.get("outputs", []) if name else []:
                for kind in ("image/png", "image/jpeg"):
                    if picture := output.get("data", {}).get(kind):
                        alt = shown["image"]["alt"]
                        found.setdefault(name, Figure(path.stem, b64decode(picture), alt))
    return found


def show_picture(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Put the picture of a function behind the first paragraph of its docstring."""
    if name not in PICTURES:
        return
    anchor = PICTURES[name]
    figure = read_figures()[anchor]
    width, height = figure.small().size
    html = (
        f'<a class="function-picture" href="../notebooks/{figure.stem}.html#{anchor}">'
        f'<img src="../_static/pictures/{anchor}.webp" alt="{escape(figure.alt)}" '
        f'width="{2 * width // 3}" height="{2 * height // 3}" loading="lazy"></a>'
    )
    # Numpydoc may begin with empty lines.
    begin = next(k for k, line in enumerate(lines) if line)
    end = lines.index("", begin) if "" in lines[begin:] else len(lines)
    lines[end:end] = ["", ".. raw:: html", "", f"   {html}", ""]


def write_pictures(app: Sphinx, error: Exception | None) -> None:
    if error or app.builder.format != "html":
        return
    folder = Path(app.outdir) / "_static" / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    for anchor in sorted(set(PICTURES.values())):
        (folder / f"{anchor}.webp").write_bytes(read_figures()[anchor].webp())


def setup(app: Sphinx) -> dict[str, bool]:
    # After numpydoc, which rewrites the lines it is given.
    app.connect("autodoc-process-docstring", show_picture, priority=900)
    app.connect("build-finished", write_pictures)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
