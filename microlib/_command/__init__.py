"""The command ``microlib``: four tasks on files of one's own, each a few calls of the library."""

from microlib._command._main import main

__all__ = ["main"]
