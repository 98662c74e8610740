"""Drawing shared by the notebooks; no computation, and no algorithm imports it."""

from microlib.figures.style import COLORS, use_style

__all__ = ["COLORS", "use_style"]
