"""Computer vision and mechanics for microstructures seen through an optical microscope.

Import the subject you need, for example ``from microlib.membrane import elastic_modulus``. One unit
system throughout: µm, µN, s, so that moduli are in MPa; pixel quantities say so.
"""

from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from os import PathLike
from typing import Any

if find_spec("cv2") is None:
    raise ImportError("microlib needs OpenCV 4.10 or newer: pip install opencv-python-headless")

try:
    __version__ = version("microlib-thesis")
except PackageNotFoundError:  # a checkout that was never installed
    __version__ = "0.3.0"


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


__all__ = ["__version__", "load"]
