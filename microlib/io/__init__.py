"""Frames in, results out: files are written whole or not at all."""

from microlib.io._files import read_grey, write_height_tiff, write_ply
from microlib.io._frames import read_frames

__all__ = ["read_frames", "read_grey", "write_height_tiff", "write_ply"]
