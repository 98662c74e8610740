"""Hand display formulas to MathJax as they were written.

Sphinx wraps a formula that holds a line break in ``split``. LaTeX knows no ``\\tag`` inside that
environment, and MathJax prints such a formula as red source. A formula with the thesis' own number
is delimited here instead, so that the ``\\tag`` stands outermost.
"""

from __future__ import annotations

from typing import ClassVar

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import SphinxPostTransform


class KeepTags(SphinxPostTransform):
    """Delimit every tagged formula, and leave nothing of it to Sphinx."""

    default_priority = 200
    formats: ClassVar[tuple[str, ...]] = ("html",)

    def run(self, **kwargs: object) -> None:
        for node in self.document.findall(nodes.math_block):
            text = node.astext()
            if r"\tag{" in text and not node.get("nowrap"):
                node.children = [nodes.Text(rf"\[{text}\]")]
                node["nowrap"] = True


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_post_transform(KeepTags)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
