"""Computer vision and mechanics for microstructures seen through an optical microscope.

Import the subject you need, for example ``from microlib.membrane import elastic_modulus``. One unit
system throughout: µm, µN, s, so that moduli are in MPa; pixel quantities say so.
"""

from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

if find_spec("cv2") is None:
    raise ImportError("microlib needs OpenCV 4.10 or newer: pip install opencv-python-headless")

try:
    __version__ = version("microlib-thesis")
except PackageNotFoundError:  # a checkout that was never installed
    __version__ = "0.3.0"

__all__ = ["__version__"]
