"""The laws of every public name of automation: units, origins, a second use."""

from __future__ import annotations

import numpy as np
import pytest

from microlib.automation import LiveDepth, acquire_depth, autofocus
from microlib.synthetic import focal_stack, mixed_texture
from tests.automation.test_acquire import POSITIONS, Scope, bell
from tests.laws import Law, hold, hold_same_as_new

PLACES = np.array([0.0, 9.0, 20.0, 31.0, 40.0, 52.0, 60.0, 69.0])
STACK = focal_stack(
    mixed_texture((30, 40), np.random.default_rng(0)), np.full((30, 40), 23.0), PLACES,
    blur_rate=0.1,
)  # fmt: skip


def looked(u, farthest: float, way: int) -> dict:
    live, reasons = LiveDepth(farthest=farthest), []
    for frame, z in zip(STACK[::way], u.z0 + PLACES[::way] * u.um, strict=True):
        live.push(frame, z)
        reasons.append(live.done)
    depth = live.result().depth
    return {"done": reasons, "depth": live.depth, "result": depth, "positions": live.positions}


def scope(u, center: float) -> Scope:
    return Scope(lambda z: float(bell(center, 30.0, 1.0, 0.02)((z - u.z0) / u.um)))


def acquired(call, **given) -> dict:
    run = call(**given)
    names = ("positions", "images", "frames", "focus", "complete", "still", "error")
    about = {name: getattr(run, name) for name in names}
    return about if run.result is None else {**about, "depth": run.result.depth}


RUN = {
    **dict.fromkeys(("images", "frames", "complete", "still", "error"), "="),
    **dict.fromkeys(("positions", "focus", "depth"), "um @ z0"),
}
LOOK = Law(
    lambda u: {"u": u, "farthest": u.z0 + 40.0 * u.um, "way": 1},
    {"done": "=", **dict.fromkeys(("depth", "result", "positions"), "um @ z0")},
    within=1e-4,  # depths are of single precision
    call=looked,
)
LAWS = {
    "automation.LiveDepth": LOOK,
    "automation.LiveDepth.push": LOOK,
    "automation.LiveDepth.result": LOOK,
    "automation.acquire_depth": Law(lambda u: {"call": acquire_depth,
        "workstation": scope(u, 72.0), "positions": u.z0 + POSITIONS[::-1] * u.um,
        "farthest": u.z0 + 40.0 * u.um, "timeout": 4.0 * u.s}, RUN, within=1e-4, again=False,
        call=acquired),
    "automation.autofocus": Law(lambda u: {"call": autofocus, "workstation": scope(u, 72.0),
        "positions": u.z0 + POSITIONS * u.um, "timeout": 4.0 * u.s}, {k: v for k,
        v in RUN.items() if k != "depth"}, within=1e-4, again=False, call=acquired),
}  # fmt: skip


@pytest.mark.parametrize("name", LAWS)
def test_outputs_follow_units_and_origins(name: str) -> None:
    hold(name, LAWS[name])


def test_frames_from_the_other_side_have_the_same_depth() -> None:
    u = type("", (), {"z0": 3.0, "um": 1.0})
    there, back = looked(u, 43.0, 1), looked(u, 23.0, -1)
    # The fit of a peak begins at another frame and ends 0.1 % of a spacing away at most.
    np.testing.assert_allclose(there["result"], back["result"], atol=0.03)
    np.testing.assert_allclose(there["depth"], back["depth"], atol=1e-3)


def test_a_depth_and_a_drive_that_were_used_are_as_new() -> None:
    def fill(live: LiveDepth) -> dict:
        for frame, z in zip(STACK[live.frames :], PLACES[live.frames :], strict=True):
            live.push(frame, z)
        return {"depth": live.depth, "result": live.result().depth, "done": live.done}

    refused = (
        lambda live: live.push(STACK[0][0], 1.0),
        lambda live: live.push(STACK[0], np.nan),
        lambda live: [live.push(frame, z) for frame, z in zip(STACK[:4], PLACES, strict=False)],
        lambda live: live.push(STACK[4], PLACES[2]),
        lambda live: (live.result(), live.depth),
        lambda live: live.push(STACK[4].astype(float), PLACES[4]),
    )
    hold_same_as_new(lambda: LiveDepth(farthest=40.0), fill, *refused)
    u = type("", (), {"z0": 0.0, "um": 1.0})

    def find(station: Scope) -> dict:
        return acquired(acquire_depth, workstation=station, positions=POSITIONS, farthest=90.0)

    hold_same_as_new(
        lambda: scope(u, 72.0),
        find,
        lambda station: autofocus(station, POSITIONS),
        lambda station: acquire_depth(station, POSITIONS, region=(20, 1, 9, 9)),
        lambda station: acquire_depth(station, [0.0, 1.0]),
    )
