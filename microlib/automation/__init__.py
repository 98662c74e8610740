"""What joins several subjects on a live microscope: depth while acquiring, and an injection."""

from microlib.automation._acquire import acquire_depth, autofocus
from microlib.automation._injection import inject
from microlib.automation._live import LiveDepth

__all__ = ["LiveDepth", "acquire_depth", "autofocus", "inject"]
