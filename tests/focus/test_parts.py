"""Parts of the depth on numbers whose answer is known: poses, links, selections and patches."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from microlib.focus import _survey
from microlib.focus._links import basis, fit_link, motion_columns, spread_over_stack
from microlib.focus._nearest import filled, gradients
from microlib.focus._poses import Frame, Geometry, reduced
from microlib.focus._questions import Question, answered
from microlib.focus._replay import Replay
from microlib.focus._selection import as_type, select, warped
from microlib.focus._stack import _counted
from microlib.focus._survey import _patch, held
from microlib.focus._tiles import tiles_of
from microlib.focus._window import Window

FRAME = Frame(1.02 * np.exp(0.03j), 3.0 - 2.0j, np.array([0.1, 0.2, -0.1, 0.05, 0.03, -0.2]), 4.0)


def test_a_frame_moves_in_its_own_turn_and_brightens_by_its_own_gain() -> None:
    moved = FRAME.moved(np.array([0.01, 0.02, 0.5, -0.25]))
    assert moved.turn == pytest.approx(FRAME.turn * np.exp(0.01 + 0.02j))
    assert moved.shift == pytest.approx(FRAME.shift + FRAME.turn * (0.5 - 0.25j))
    assert moved.offset == 4.0
    np.testing.assert_array_equal(moved.log_gain, FRAME.log_gain)
    more = np.array([0.3, 0.0, 0.1, 0.0, 0.0, 0.0])
    brighter = FRAME.brighter(more, 2.0)
    np.testing.assert_allclose(brighter.log_gain, FRAME.log_gain + more)
    assert brighter.offset == pytest.approx(4.0 + np.exp(0.1) * 2.0)
    assert (brighter.turn, brighter.shift) == (FRAME.turn, FRAME.shift)
    same = Frame.same()
    assert (same.turn, same.shift, same.offset) == (1, 0, 0)
    assert not same.log_gain.any()


@pytest.mark.parametrize("factor", [1, 3])
def test_reduced_pixels_know_where_they_are(factor: int) -> None:
    geometry = Geometry((32, 47), factor)
    assert geometry.small == (32 // factor, 47 // factor)
    x, y = geometry.axes()
    full_x, full_y = np.arange(47.0) - 23, np.arange(32.0) - 15.5
    blocks = full_x[: len(x) * factor].reshape(-1, factor).mean(axis=1)
    np.testing.assert_allclose(x, blocks)
    np.testing.assert_allclose(y, full_y[: len(y) * factor].reshape(-1, factor).mean(axis=1))
    gx, gy = geometry.coordinates()
    np.testing.assert_array_equal(gx, np.tile(x, (len(y), 1)))
    np.testing.assert_array_equal(gy[:, 0], y)
    u, v = gx / 23.5, gy / 23.5
    log_gain = np.tensordot(FRAME.log_gain, basis(u, v), 1)
    np.testing.assert_allclose(geometry.gain(FRAME), np.exp(log_gain), rtol=1e-5)
    # The map takes the pixel at x from the center to turn · x + shift.
    found = geometry.matrix(FRAME) @ [5.0, 7.0, 1.0]
    there = FRAME.turn * (x[5] + 1j * y[7]) + FRAME.shift
    first = x[0] + 1j * y[0]
    np.testing.assert_allclose(found[0] + 1j * found[1], (there - first) / factor, atol=1e-6)
    image = np.asarray(gx + 100 * gy, np.float32)
    seen = geometry.warped(image, FRAME, flags=cv2.INTER_LINEAR)
    inside = geometry.inside(FRAME)
    place = FRAME.turn * (gx + 1j * gy) + FRAME.shift
    reach = (np.abs(place.real - gx.mean()) <= np.ptp(gx) / 2 + 1e-3) & (
        np.abs(place.imag - gy.mean()) <= np.ptp(gy) / 2 + 1e-3
    )
    np.testing.assert_array_equal(inside, reach)
    assert 0.5 < inside.mean() < 1
    # OpenCV counts in 32nds of a pixel.
    np.testing.assert_allclose(
        seen[inside], (place.real + 100 * place.imag)[inside], atol=100 * factor / 30
    )


def test_blocks_that_are_not_full_are_left_out() -> None:
    image = np.arange(35.0).reshape(5, 7)
    np.testing.assert_allclose(
        reduced(image, 2), image[:4, :6].reshape(2, 2, 3, 2).mean(axis=(1, 3))
    )
    assert reduced(image, 1).dtype == np.float32


def test_the_columns_of_a_motion_are_what_it_changes() -> None:
    y, x = np.mgrid[-20:21, -25:26].astype(np.float32)

    def scene(u, v):
        return 0.3 * u + 0.02 * u * v - 0.01 * v**2  # whose central differences are exact

    columns = motion_columns(scene(x, y).astype(np.float32), x, y)
    for column, (growth, rotation, dx, dy) in zip(columns, np.eye(4), strict=True):
        t = 1e-4
        turned = (x + 1j * y - t * (dx + 1j * dy)) / np.exp(t * (growth + 1j * rotation))
        change = (scene(turned.real, turned.imag) - scene(x, y)) / t
        np.testing.assert_allclose(column[2:-2, 2:-2], change[2:-2, 2:-2], atol=0.02)


def test_a_link_leaves_out_what_is_far_off_and_what_has_no_weight() -> None:
    rng = np.random.default_rng(0)
    shape = (60, 70)
    columns = [rng.normal(0, 1, shape).astype(np.float32) for _ in range(3)]
    columns.append(np.zeros(shape, np.float32))
    difference = sum(c * k for c, k in zip(columns, (0.5, -1.0, 2.0, 0.0), strict=True))
    noise = rng.normal(0, 0.1, shape)
    stray = rng.random(shape) < 0.1
    spoiled = np.asarray(difference + noise + np.where(stray, 3.0, 0), np.float32)
    weight = np.ones(shape, np.float32)
    weight[:10] = 0
    spoiled[:10] = 1e3
    found = fit_link(columns, spoiled, weight)
    # 3300 pixels of 0.1 know each to 0.002; with the strays an error of 0.3 · 3/√3300 more.
    np.testing.assert_allclose(found, [0.5, -1.0, 2.0, 0.0], atol=0.01)
    # Tukey's weights of a first fit by least squares, by hand.
    use = weight.ravel() > 0
    design = np.stack([c.ravel()[use] for c in columns[:3]]).astype(float)
    target = spoiled.ravel()[use].astype(float)
    first = np.linalg.lstsq(design.T, target, rcond=None)[0]
    residual = target - first @ design
    spread = 1.4826 * np.median(np.abs(residual[::5]))
    tukey = np.maximum(1 - (residual / (4.685 * spread)) ** 2, 0)  # squared, its root is this
    second = np.linalg.lstsq((design * tukey).T, target * tukey, rcond=None)[0]
    np.testing.assert_allclose(found[:3], second, atol=2e-5)


def test_values_are_spread_over_the_frames_by_the_weights_of_their_links() -> None:
    rng = np.random.default_rng(1)
    links = [(0, 1), (1, 2), (2, 3), (0, 2), (1, 3), (0, 3)]
    values, weights = rng.normal(0, 1, (6, 2)), np.array([1.0, 2.0, 0.5, 1.0, 0.0, 3.0])
    found = spread_over_stack(4, links, values, weights, 2)
    design = np.zeros((6, 4))
    for row, (i, j) in enumerate(links):
        design[row, [i, j]] = -1.0, 1.0
    root = np.sqrt(weights)[:, None]
    free = np.delete(design, 2, axis=1)
    expected = np.linalg.lstsq(root * free, root * values, rcond=None)[0]
    np.testing.assert_allclose(np.delete(found, 2, axis=0), expected, atol=1e-9)
    assert not found[2].any()


def test_pixels_come_from_the_frames_that_are_named() -> None:
    frames = [np.full((3, 4, 3), 10 * k, np.uint8) for k in range(3)]
    index = np.array([[0, 1, 2, -1], [-1, -1, 1, 1], [2, 2, -1, 0]])
    found = select(iter(frames), index)
    assert found.dtype == np.uint8
    known = index >= 0
    np.testing.assert_array_equal(found[known], 10 * index[known][:, None].repeat(3, axis=1))
    assert found[1, 0, 0] in (0, 20)  # of a neighbor
    assert found[0, 3, 0] in (10, 20)
    assert not select(frames, np.full((3, 4), -1)).any()
    with pytest.raises(ValueError, match="frames must be at least 3, got 2"):
        select(frames[:2], index)
    with pytest.raises(ValueError, match=r"frames must have the shape \(3, 4\), got \(2, 4\)"):
        select([frames[0], frames[1][:2]], index)


def test_numbers_are_rounded_into_their_type() -> None:
    grey = np.array([-3.0, 1.4, 1.6, 254.6, 300.0])
    np.testing.assert_array_equal(as_type(grey, np.dtype(np.uint8)), [0, 1, 2, 255, 255])
    np.testing.assert_array_equal(as_type(grey, np.dtype(np.int16)), [-3, 1, 2, 255, 300])
    assert as_type(grey, np.dtype(np.float32)).dtype == np.float32
    image = np.random.default_rng(0).integers(0, 255, (20, 30)).astype(np.uint8)
    np.testing.assert_array_equal(
        warped(image, np.array([[1.0, 0, 2], [0, 1, -3]]))[3:, :-2], image[:-3, 2:]
    )


def test_the_nearest_known_depth_is_within_its_reach() -> None:
    rng = np.random.default_rng(2)
    depth = rng.normal(0, 1, (60, 130))
    depth[rng.random(depth.shape) < 0.97] = np.nan
    depth[:, 60:] = np.nan
    depth[5, 129] = 7.0
    found = filled(depth)
    known = np.argwhere(np.isfinite(depth))
    for row, col in rng.integers(0, (60, 130), (200, 2)):
        off = np.hypot(*(known - [row, col]).T)
        nearest = {np.float32(depth[tuple(k)]) for k in known[off == off.min()]}
        if off.min() < 48:
            assert found[row, col] in nearest
    lonely = np.full((1, 200), np.nan)
    lonely[0, 100] = 3.0
    reached = np.flatnonzero(filled(lonely)[0])
    assert (reached[0], reached[-1]) == (52, 148)
    tall = np.full((200, 1), np.nan)
    tall[100, 0] = 3.0
    reached = np.flatnonzero(filled(tall)[:, 0])
    assert (reached[0], reached[-1]) == (52, 148)


def test_slopes_of_a_line_of_pixels_are_none_across() -> None:
    down, along = gradients(np.array([[0.0, 2.0, 6.0]]))
    assert not down.any()
    np.testing.assert_array_equal(along, [[2.0, 3.0, 4.0]])


def test_parts_answer_each_other_in_step_and_are_told_what_is_known() -> None:
    asked = []

    def part(value):
        first = yield Question("sum", lambda: asked.append(value) or value, sum)
        second = yield Question("most", lambda: value * first, max)
        return first, second

    known: dict = {}
    assert answered([part(1), part(2), part(4)], known) == [(7, 28)] * 3
    assert known == {"sum": 7, "most": 28}
    asked.clear()
    assert answered([part(5)], {"sum": 2}) == [(2, 10)]
    assert asked == []


def test_a_patch_lies_around_its_square_inside_the_image() -> None:
    side = _survey._SIDE
    middle = _patch(Window(600, 700, 664, 764, (2000, 3000)))
    assert (middle.top, middle.left, middle.size) == (632 - 192, 732 - 192, (384, 384))
    corner = _patch(Window(0, 2936, 64, 3000, (2000, 3000)))
    assert (corner.top, corner.left, corner.bottom, corner.right) == (0, 3000 - side, side, 3000)
    narrow = _patch(Window(500, 0, 564, 64, (2000, 200)))
    assert (narrow.left, narrow.size) == (0, (384, 200))
    assert (side, _survey._PATCHES, _survey.MOST_PIXELS) == (384, 9, 4 * 1024**2)


def test_a_large_stack_is_surveyed_by_the_patches_of_its_lowest_and_highest_peaks(
    monkeypatch,
) -> None:
    """Nine of a hundred squares, evenly through the ranks of their peaks."""
    shape = (640, 640)
    squares = tiles_of(Window.whole(shape), 64)
    heights = np.random.default_rng(0).permutation(len(squares)).astype(float)
    looked = []

    class Stack:
        def __init__(self) -> None:
            self.shape = shape

        def parts(self, windows):
            looked.append(windows)
            return [
                [np.full((2, 2), 10.0 * k + j) for k in range(3)] for j, _ in enumerate(windows)
            ]

    def steps(part, axis, **turn):
        seen.append((part.window, axis, turn))
        return iter(())

    seen: list = []
    monkeypatch.setattr(_survey, "MOST_PIXELS", 1000)
    monkeypatch.setattr(_survey, "square_windows", lambda given: squares)
    monkeypatch.setattr(_survey, "width_of_squares", lambda parts, given: (3.5, heights))
    monkeypatch.setattr(_survey, "depth_steps", steps)
    told = {"noise": 1.0, "silence": 2.0, "weights": np.ones(3), "noise_curve": None}
    told["pull"] = np.ones((3, 4))
    monkeypatch.setattr(_survey, "answered", lambda parts, answers: answers.update(told))
    z = np.arange(3.0)
    survey = _survey.survey_of(Stack(), z, points=5, batch=2, workers=1)
    chosen = [squares[int(np.flatnonzero(heights == r)[0])] for r in np.linspace(0, 99, 9).round()]
    assert looked[1] == [_patch(square) for square in chosen]
    assert len(seen) == 9
    np.testing.assert_allclose(survey.levels, 10.0 * z + 4.0)  # the mean of all patches
    assert survey.width == 3.5
    assert all(turn["thorough"] for *_, turn in seen)
    assert {(turn["points"], turn["batch"], turn["workers"]) for *_, turn in seen} == {(5, 2, 1)}


def test_frames_that_are_held_can_be_read_again() -> None:
    frames = [np.zeros((4, 5)), np.ones((4, 5))]
    part = held(frames)
    assert len(list(part.frames())) == len(list(part.frames())) == 2
    assert part.window == part.wanted == Window.whole((4, 5))
    inner, outer = Window(1, 1, 2, 2, (9, 9)), Window(0, 0, 4, 5, (9, 9))
    assert (held(frames, outer, inner).window, held(frames, outer, inner).wanted) == (outer, inner)


STACK = np.random.default_rng(4).integers(0, 60000, (4, 20, 30)).astype(np.uint16)
SOURCES = {
    "array": lambda: STACK,
    "list": lambda: list(STACK),
    "generator": lambda: iter(STACK),
}


@pytest.mark.parametrize("in_parts", [False, True])
@pytest.mark.parametrize("source", SOURCES)
def test_a_stack_is_read_as_often_as_is_asked_and_in_parts(source: str, in_parts: bool) -> None:
    windows = [Window(2, 3, 9, 14, (20, 30)), Window(11, 0, 20, 30, (20, 30))]
    with Replay(SOURCES[source](), 4, in_parts=in_parts) as stack:
        assert stack.shape == (20, 30)
        for _ in range(2):
            read = list(stack)
            assert len(read) == 4
            assert all(frame.dtype == np.uint16 for frame in read)
            np.testing.assert_array_equal(np.stack(read), STACK)
        for window, part in zip(windows, stack.parts(windows), strict=True):
            rows, cols = slice(window.top, window.bottom), slice(window.left, window.right)
            np.testing.assert_array_equal(np.stack(part), STACK[:, rows, cols])
        kept = source == "generator" or (in_parts and source == "list")
        assert (stack._kept is not None) == kept
    if kept:
        assert stack._kept.closed


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize(("count", "got"), [(3, "more than 3 and 3"), (5, "4 and 5")])
def test_another_number_of_frames_is_refused(source: str, count: int, got: str) -> None:
    message = f"frames and positions must be as many, got {got}"
    with Replay(SOURCES[source](), count) as stack, pytest.raises(ValueError, match=message):
        list(stack)
    with (
        Replay(iter(()), count) as stack,
        pytest.raises(ValueError, match="three frames, got none"),
    ):
        list(stack)


def test_progress_counts_the_frames_of_all_passes() -> None:
    told: list = []
    frames = list(_counted(STACK, lambda *at: told.append(at), 4, 3, 1))
    assert len(frames) == 4
    assert told == [(5, 12), (6, 12), (7, 12), (8, 12)]
    assert len(list(_counted(STACK, None, 4, 3, 1))) == 4
    assert len(list(_counted(iter(STACK), lambda *at: told.append(at), None, 1, 0))) == 4
    assert len(told) == 4  # of a stream nobody knows how many there are
