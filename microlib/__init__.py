"""Computer vision and mechanics for microstructures seen through an optical microscope.

``import microlib`` and use ``microlib.membrane.elastic_modulus``, or import the subject you need; a
subject is loaded when it is first used. One unit system throughout: µm, µN, s, so that moduli are
in MPa; pixel quantities say so.
"""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from os import PathLike
from typing import Any

try:
    __version__ = version("microlib-thesis")
except PackageNotFoundError:  # a checkout that was never installed
    __version__ = "0.4.0"

_SUBJECTS = (
    "batch",
    "calibration",
    "curvature",
    "embryo",
    "focus",
    "io",
    "membrane",
    "microscope",
    "optics",
    "servoing",
    "synthetic",
    "tracking",
)


def load(path: str | PathLike[str]) -> Any:
    """Read a result of any kind that its ``save`` has kept; `microlib._common` says more.

    Parameters
    ----------
    path : path-like
        The file, a NumPy archive.

    Returns
    -------
    object
        The result, such as the `microlib.focus.FocusResult` that was saved.

    Raises
    ------
    ValueError
        If there is no such file, or it holds no result of this library.
    """
    from microlib._common import load as load_result  # here, so that `import microlib` stays quick

    return load_result(path)


def __getattr__(name: str) -> Any:
    if name in _SUBJECTS:
        return import_module(f"microlib.{name}")
    raise AttributeError(f"module 'microlib' has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)


__all__ = ["__version__", "load", *_SUBJECTS]
