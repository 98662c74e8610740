"""The scripts of the page "Try it", and the focal stack that one of them reads.

They stand outside ``_static``, all scripts of which jupyter-book loads on every page. The stack is
rendered when the book is built. No extension knows these scripts.
"""

from __future__ import annotations

import json
import shutil
from base64 import b64encode
from pathlib import Path

import numpy as np
from book_tables import when_written
from numpy.typing import NDArray
from sphinx.application import Sphinx

from microlib.synthetic import focal_stack, mixed_texture, paraboloid

SIDE = 112  # px: twelve frames are then 200 kB
HEIGHT, SPACING = 250.0, 25.0  # µm
SEED = 3


def render_stack() -> tuple[NDArray[np.uint8], NDArray[np.float64], NDArray[np.float64]]:
    """Return the frames of a dome, their positions and the true heights, µm."""
    shape = (SIDE, SIDE)
    height = paraboloid(shape, HEIGHT)
    positions = np.arange(0.0, HEIGHT + SPACING + 1, SPACING)
    # A frame's spacing out of focus blurs by half a pixel, as much as there is in focus.
    frames = focal_stack(
        mixed_texture(shape, SEED), height, positions, blur_rate=0.02, noise=1.0, rng=SEED
    )
    return frames, positions, height


def write_scripts(app: Sphinx) -> None:
    """Copy the scripts, and write the stack as one, all that a page opened from a file can read."""
    folder = Path(app.outdir) / "_static" / "try"
    shutil.copytree(Path(app.srcdir) / "_try", folder, dirs_exist_ok=True)
    frames, positions, height = render_stack()
    stack = {
        "rows": SIDE,
        "cols": SIDE,
        "positions": positions.tolist(),
        "truth": height.round().astype(int).ravel().tolist(),
        "data": [b64encode(frame.tobytes()).decode() for frame in frames],
    }
    text = json.dumps(stack, separators=(",", ":"))
    (folder / "stack.js").write_text(f"(globalThis.tryIt ??= {{}}).stack = {text};\n", "utf-8")


def setup(app: Sphinx) -> None:
    when_written(app, write_scripts)
