"""Computer vision and mechanics for microstructures seen through an optical microscope.

``import microlib`` and use ``microlib.membrane.elastic_modulus``, or import the subject you need; a
subject is loaded when it is first used. One unit system throughout: µm, µN, s, so that moduli are
in MPa; quantities in pixels are marked as such.
"""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any

try:
    __version__ = version("microlib-thesis")
except PackageNotFoundError:  # a checkout that was never installed
    __version__ = "0.6.0"

_SUBJECTS = (
    "calibration",
    "curvature",
    "embryo",
    "estimate",
    "focus",
    "io",
    "membrane",
    "microscope",
    "optics",
    "servoing",
    "synthetic",
    "tracking",
)


def __getattr__(name: str) -> Any:
    if name in _SUBJECTS:
        return import_module(f"microlib.{name}")
    raise AttributeError(f"module 'microlib' has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)


__all__ = ["__version__", *_SUBJECTS]
