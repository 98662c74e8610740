"""Drawing shared by the notebooks; no computation, and no algorithm imports it."""

from compendium.figures.data import show
from compendium.figures.style import COLORS, use_style

__all__ = ["COLORS", "show", "use_style"]
