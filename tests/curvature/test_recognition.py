"""Parts of exact form and known pose, shapes that are none, and the graph behind the verdict."""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np
import pytest

from benchmarks import recognition as held_out
from microlib import synthetic
from microlib.curvature import PART_KINDS, recognize_part
from microlib.curvature._descriptor import describe
from microlib.curvature._graph import FAMILY_NAMES, region_graph
from microlib.curvature._grid import on_grid, white_noise
from microlib.curvature._recognition import PartRecognition

SIDE = 96
Y, X = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2


def ball(radius: float = 28.0, x: float = 0.0, y: float = 0.0) -> np.ndarray:
    square = (X - x) ** 2 + (Y - y) ** 2
    return np.sqrt(np.maximum(radius**2 - square, 0)) + radius * (square < radius**2)


def rod(radius: float = 20.0, turn: float = 0.5) -> np.ndarray:
    across = X * np.cos(turn) + Y * np.sin(turn)
    return np.sqrt(np.maximum(radius**2 - across**2, 0))


PARTS: dict[str, np.ndarray] = {
    "sphere": ball(),
    "cylinder": rod(),
    "cone": np.maximum(30 - np.hypot(X, Y), 0),
    "plane": 0.2 * X - 0.1 * Y,
    "saddle": (X**2 - Y**2) / 150,
    "step": 15.0 * (X + 0.3 * Y > 3),
}


def test_the_kinds_are_those_that_are_promised() -> None:
    assert set(PARTS) == set(PART_KINDS)


@pytest.mark.parametrize("kind", PARTS)
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_parts_are_named_and_say_why(kind: str, noise: float) -> None:
    z = PARTS[kind] + noise * np.random.default_rng(1).standard_normal(X.shape)
    found = recognize_part(z, 1.0, noise=noise)
    assert (found.kind, found.reason) == (kind, "")
    assert found.confidence > 0.5
    assert found.distance <= 1
    assert max(found.probabilities, key=found.probabilities.__getitem__) == kind
    assert sum(found.probabilities.values()) == pytest.approx(1)


@pytest.mark.parametrize("kind", ["sphere", "cylinder", "cone", "step"])
def test_units_turns_and_mirror_images_change_nothing(kind: str) -> None:
    z = PARTS[kind] + 0.02 * np.random.default_rng(2).standard_normal(X.shape)
    first = recognize_part(z, 1.0, noise=0.02)
    others = {
        "unit": recognize_part(1e-3 * z, 1e-3, noise=2e-5),
        "height": recognize_part(z + 1e3, 1.0, noise=0.02),
        "quarter": recognize_part(np.rot90(z), 1.0, noise=0.02),
        "mirror": recognize_part(z[:, ::-1], 1.0, noise=0.02),
    }
    for what, other in others.items():
        # Only the order of sums differs; a pixel at a threshold may fall to the other side.
        assert other.kind == first.kind, what
        assert other.confidence == pytest.approx(first.confidence, abs=0.02), what


@pytest.mark.parametrize(
    ("kind", "z", "pitch"),
    [
        ("sphere", synthetic.sphere_on_plane((128, 128), 45.0, 1.0), 1.0),
        ("sphere", synthetic.sphere_on_plane((160, 160), 250.0, 4.3, roughness=3.0, rng=0), 4.3),
        ("sphere", synthetic.quadric_patch(1, half=40, radius=80.0), 1.0),
        ("cylinder", synthetic.parabolic_cylinder((128, 128), 30.0, width=80.0), 1.0),
        ("cylinder", synthetic.parabolic_cylinder((128, 128), 500.0), 5.0),
        ("cone", synthetic.cone((128, 128), 45.0, 50.0), 1.0),
        ("plane", synthetic.tilted_plane((128, 128), 0.3, 0.1), 1.0),
        ("saddle", synthetic.quadric_patch(6, half=40, radius=80.0), 1.0),
        ("step", synthetic.step((128, 128), 2.0), 1.0),
        (None, synthetic.quadric_patch(7, half=40, radius=80.0), 1.0),
        (None, synthetic.quadric_patch(8, half=40, radius=80.0), 1.0),
    ],
)
def test_the_surfaces_of_the_thesis_are_named(
    kind: str | None, z: np.ndarray, pitch: float
) -> None:
    assert recognize_part(z, pitch).kind == kind


def test_held_out_solids_are_named_at_a_threshold_of_six_tenths() -> None:
    """Six of each kind, of the benchmark's seed 5; it measures hundreds of another seed."""
    wrong = []
    for number, kind in enumerate(PART_KINDS):
        for k in range(6):
            rng = np.random.default_rng([5, number, k])
            one = held_out.scene(kind, rng.uniform(0.18, 0.38), rng, (96, 96))
            noise = 0.6 * one.bend / (held_out.ERRORS * held_out.FLAT_ERROR)
            z = one.height + noise * rng.standard_normal(one.height.shape)
            said = recognize_part(z, 1.0, noise=noise).kind
            wrong += [(kind, k, said)] * (said != kind)
    # 98 of 100 are promised: of 36, two wrong have a chance of one in six, three of 4 %.
    assert len(wrong) <= 2, wrong


def test_unknown_shapes_are_refused_with_the_reason() -> None:
    said = []
    for number, kind in enumerate(held_out.UNKNOWN):
        for k in range(5):
            rng = np.random.default_rng([6, number, k])
            one = held_out.scene(kind, rng.uniform(0.2, 0.38), rng, (96, 96))
            found = recognize_part(one.height, 1.0)
            assert (found.kind is None) == bool(found.reason)
            said.append(found.kind)
    # Nine of ten are promised: of 15, three named have a chance of 18 %, four of 6 %.
    assert sum(kind is not None for kind in said) <= 3, said


def test_noise_alone_is_a_plane() -> None:
    z = np.random.default_rng(3).standard_normal((80, 100))
    assert recognize_part(z, 1.0).kind == "plane"
    assert recognize_part(np.zeros((64, 64)), 1.0).kind == "plane"


def test_large_maps_and_small_holes_are_taken() -> None:
    z = 3 * np.kron(ball(), np.ones((3, 3)))
    z[100:110, 120:128] = np.nan
    found = recognize_part(z, 1.0)
    assert found.kind == "sphere"
    assert found.labels.shape == z.shape


def test_a_map_of_holes_is_refused() -> None:
    z = ball()
    z[:, :30] = np.nan
    found = recognize_part(z, 1.0)
    assert found.kind is None
    assert "unknown" in found.reason
    assert recognize_part(np.full((64, 64), np.nan), 1.0).kind is None


def test_the_graph_of_a_ball_is_a_dome_in_a_ring_in_a_ground() -> None:
    low = 12.0 * np.exp(-(X**2 + Y**2) / (2 * 14.0**2))
    found = recognize_part(low, 1.0, noise=0.001)
    regions, borders = found.regions, found.borders
    (dome,) = np.flatnonzero(regions["family"] == "convex")
    # A bell of width s and height a has H = −a/s² and K = H² on top, less in the mean around it.
    assert -12 / 14**2 < regions["mean"][dome] < -12 / 14**2 / 4
    assert regions[["x", "y"]].loc[dome].to_numpy() == pytest.approx((SIDE - 1) / 2, abs=0.5)
    touching = {frozenset(pair) for pair in borders[["one", "two"]].to_numpy().tolist()}
    neighbors = {regions["family"][next(iter(pair - {dome}))] for pair in touching if dome in pair}
    assert "flat" not in neighbors
    assert found.labels[SIDE // 2, SIDE // 2] == 1
    assert regions["area"].sum() == pytest.approx(1, abs=1e-9)


def test_the_graph_counts_regions_and_borders() -> None:
    labels = np.array([[1, 1, 5, 5], [1, 1, 5, 5], [9, 9, 9, 5]], np.uint8)
    graph = region_graph(labels)
    assert [FAMILY_NAMES[f] for f in graph.family] == ["convex", "flat", "concave"]
    assert graph.area.tolist() == [4, 5, 3]
    assert graph.edges.tolist() == [[1, 2, 2], [1, 3, 2], [2, 3, 2]]
    assert len(region_graph(np.full((3, 3), 5, np.uint8)).edges) == 0


def test_noise_is_estimated_beside_edges_and_averaged_with_the_map() -> None:
    z = ball() + 0.1 * np.random.default_rng(4).standard_normal(X.shape)
    # The median of 9000 magnitudes, of which neighbors are alike, is exact to about 2 %.
    assert white_noise(z) == pytest.approx(0.1, rel=0.08)
    large = 0.1 * np.random.default_rng(5).standard_normal((288, 192))
    grid = on_grid(large, 1.0, None)
    assert grid.height.shape == (96, 64)
    assert grid.pixel_size == 3
    assert grid.noise == pytest.approx(grid.height.std(), rel=0.05)


def test_the_description_is_the_one_that_was_learned() -> None:
    from importlib.resources import files

    text = (files("microlib.curvature") / "_part_classes.json").read_text(encoding="utf-8")
    assert set(json.loads(text)["features"]) == set(describe(ball(), 1.0, 0.01).features)


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: recognize_part(np.zeros((63, 80)), 1.0), "height"),
        (lambda: recognize_part(np.zeros((64, 129)), 1.0), "height"),
        (lambda: recognize_part(np.full((64, 64), np.inf), 1.0), "height"),
        (lambda: recognize_part(np.zeros((64, 64)), 0.0), "pixel_size"),
        (lambda: recognize_part(np.zeros((64, 64)), 1.0, noise=-1.0), "noise"),
    ],
)
def test_what_cannot_work_is_refused(call: Callable[[], PartRecognition], name: str) -> None:
    with pytest.raises(ValueError, match=name):
        call()
