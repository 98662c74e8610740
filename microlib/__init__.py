"""Computer vision and mechanics for microstructures seen through an optical microscope.

Import the subject you need, for example ``from microlib.membrane import elastic_modulus``. One unit
system throughout: µm, µN, s, so that moduli are in MPa; pixel quantities say so.
"""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("microlib")
except PackageNotFoundError:  # a checkout that was never installed
    __version__ = "0.2.0"

__all__ = ["__version__"]
