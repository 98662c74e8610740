"""What joins several subjects on a live microscope: an injection."""

from microlib.automation._injection import inject

__all__ = ["inject"]
