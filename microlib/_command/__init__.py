"""The command ``microlib``: four tasks on the user's files, each a few calls of the library."""

from microlib._command._main import main

__all__ = ["main"]
