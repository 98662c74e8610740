"""The command ``microlib``: four tasks on the user's files, each of which calls the library."""

from microlib._command._main import main

__all__ = ["main"]
