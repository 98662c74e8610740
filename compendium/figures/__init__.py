"""Drawing shared by the notebooks; no computation, and no algorithm imports it."""

from compendium.figures.data import keep_data, show
from compendium.figures.style import COLORS, use_style

__all__ = ["COLORS", "keep_data", "show", "use_style"]
