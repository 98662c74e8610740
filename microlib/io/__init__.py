"""Read the frames of a stack; write maps and meshes atomically."""

import microlib._common._opencv  # noqa: F401 – its error names the package
from microlib.io._files import read_grey, write_height_tiff, write_ply, write_stl
from microlib.io._names import in_order as in_order  # not public: for the commands
from microlib.io._pictures import image_files as image_files  # not public: for the commands
from microlib.io._read import read_frames
from microlib.io._stack import Stack

__all__ = ["Stack", "read_frames", "read_grey", "write_height_tiff", "write_ply", "write_stl"]
