"""Depth and autofocus while a microscope acquires."""

from microlib.automation._acquire import acquire_depth, autofocus
from microlib.automation._live import LiveDepth

__all__ = ["LiveDepth", "acquire_depth", "autofocus"]
