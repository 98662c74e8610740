"""What a microscope must offer to be steered: a camera, movers, and a clock.

The simulated workstation and the adapter for Micro-Manager satisfy them. Another microscope needs
four small classes with these methods, and no base class.
"""

from __future__ import annotations

from typing import Any, Protocol

from numpy.typing import NDArray

from microlib._common._types import Array


class Clock(Protocol):
    """The time that frames and commands are stamped with, real or simulated."""

    def now(self) -> float:
        """Return the time, s from any origin."""
        ...

    def sleep(self, seconds: float) -> None:
        """Let the time pass."""
        ...


class FrameSource(Protocol):
    """A camera."""

    def snap(self) -> tuple[NDArray[Any], float]:
        """Return a grey frame and the middle of its exposure, s of the clock."""
        ...


class Mover(Protocol):
    """A stage (two axes) or a focus drive (one) that goes to positions."""

    def position(self) -> Array:
        """Return the position as the encoder has it, µm, one number an axis."""
        ...

    def move_to(self, position: Array) -> None:
        """Start towards a position, µm, and return at once."""
        ...

    def moving(self) -> bool:
        """Return whether a move is under way."""
        ...

    def stop(self) -> None:
        """End any move here and now."""
        ...


class Workstation(Protocol):
    """What is steered, with the stage's axes and the clock that stamps the frames."""

    @property
    def camera(self) -> FrameSource: ...

    @property
    def stage(self) -> Mover: ...

    @property
    def focus(self) -> Mover: ...

    @property
    def clock(self) -> Clock: ...


def check_devices(workstation: object, **parts: tuple[str, ...]) -> None:
    """Refuse a workstation whose parts have not the methods that will be called."""
    for part, methods in parts.items():
        for method in methods:
            if not callable(getattr(getattr(workstation, part, None), method, None)):
                raise ValueError(
                    f"workstation must have {part}.{method}(), got {type(workstation).__name__}"
                )
