"""The page "Try it": its formulas are those of the library, and everyone can use it."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from book_try_page import render_stack
from playwright.sync_api import Browser, Page

from compendium.experiments.chapter_2 import turned_camera
from microlib.curvature import hk_labels, surface_curvature
from microlib.focus import depth_from_focus, sum_modified_laplacian
from microlib.membrane import (
    SmallSlopeWarning,
    dimple_profile,
    elastic_modulus,
    modulus_uncertainty,
)
from microlib.servoing import CameraTiming, StageModel, loop_poles, simulate
from tests.book.browsing import hindrances, open_page

COUNT = 200
# What was asked of the tools; both sides compute in doubles and differ by some roundings only.
SAME = {"rtol": 1e-9, "atol": 0.0}
DIMPLE = ("rim_radius", "dimple_depth", "probe_half_width")


@pytest.fixture
def try_page(page: Page, html: Path) -> Page:
    open_page(page, html / "try.html")
    page.wait_for_selector("[data-try=focus] .try-answer")
    return page


@pytest.fixture(scope="module")
def tools(browser: Browser, html: Path) -> Iterator[Page]:
    """The page, for tests that call its functions and change nothing on it."""
    page = browser.new_page()
    page.goto((html / "try.html").as_uri())
    yield page
    page.close()


def draw_membranes() -> list[dict[str, float]]:
    rng = np.random.default_rng(19)
    radius = rng.uniform(20, 600, COUNT)
    inputs = {
        "force": rng.uniform(1, 500, COUNT),
        "rim_radius": radius,
        "dimple_depth": radius * 10 ** rng.uniform(-2, 0, COUNT),
        "thickness": radius / 200 * rng.uniform(0.1, 1, COUNT),  # half the depth at most
        # From a needle to a probe that nearly fills the dimple, where the series takes over.
        "probe_half_width": radius * rng.uniform(0.005, 0.999, COUNT),
        "poisson_ratio": rng.uniform(-0.5, 0.5, COUNT),
    }
    return [{name: float(values[k]) for name, values in inputs.items()} for k in range(COUNT)]


def in_page(values: dict[str, float]) -> dict[str, float]:
    """Return values by the names that a script gives them, such as rimRadius."""
    return {re.sub("_(.)", lambda at: at[1].upper(), name): v for name, v in values.items()}


# The draws reach as far as the sliders: to steep dimples, and to moduli that no membrane has.
@pytest.mark.filterwarnings("ignore::microlib.membrane.SmallSlopeWarning", "ignore:a modulus of")
def test_browser_moduli_equal_library(tools: Page) -> None:
    drawn = draw_membranes()
    shares = dict(zip(drawn[0], (0.02, 0.03, 0.05, 0.1, 0.07, 0.04), strict=True))
    stds = [{name: share * abs(one[name]) for name, share in shares.items()} for one in drawn]
    radii = [(3 * v["probe_half_width"] + v["rim_radius"]) / 4 for v in drawn]
    found = tools.evaluate(
        """([inputs, stds, radii]) => inputs.map((p, k) => [tryIt.membrane.elasticModulus(p),
            tryIt.membrane.modulusStd(p, stds[k]), tryIt.membrane.dimpleProfile(radii[k], p)])""",
        [list(map(in_page, drawn)), list(map(in_page, stds)), radii],
    )
    wanted = []
    for one, std, r in zip(drawn, stds, radii, strict=True):
        profile = dimple_profile(r, **{name: one[name] for name in DIMPLE})
        wanted.append([elastic_modulus(**one), modulus_uncertainty(one, std), profile])
    np.testing.assert_allclose(found, wanted, **SAME)


def test_browser_warns_and_refuses_where_the_library_does(try_page: Page) -> None:
    assert try_page.evaluate("tryIt.membrane.STEEP") == SmallSlopeWarning.limit
    tool = try_page.locator("[data-try=modulus]")
    depth, answer = tool.get_by_label("Dimple depth (µm), exact"), tool.locator(".try-answer")
    assert answer.inner_text().startswith("E = 1.324 ± 0.061 MPa")
    for typed, warned in (("24", False), ("5", True), ("26", True)):
        depth.fill(typed)
        assert tool.locator(".try-warning").is_visible() == warned, typed
    depth.fill("2,9")
    assert depth.evaluate("field => field.validationMessage") == "Write a decimal point."
    depth.fill("2.9")
    assert "as deep as the membrane is thick" in answer.inner_text()
    tool.get_by_label("Probe half-width c (µm), exact").fill("300")
    assert "c must be below a" in answer.inner_text()


def draw_loops() -> list[tuple[float, float]]:
    rng = np.random.default_rng(21)
    loops = list(zip(rng.uniform(0.02, 2.2, COUNT), rng.uniform(0, 5, COUNT), strict=True))
    # Whole delays are what readers try first.
    return [(g, float(round(d)) if k % 10 == 0 else d) for k, (g, d) in enumerate(loops)]


def test_browser_poles_equal_library(tools: Page) -> None:
    """Each pole has its own beside it; conjugate pairs are of one size, so order is not enough."""
    loops = draw_loops()
    found = tools.evaluate("loops => loops.map(([g, d]) => tryIt.loop.poles(g, d))", loops)
    for (gain, delay), pairs in zip(loops, found, strict=True):
        wanted = loop_poles(gain, delay)
        poles = np.array(pairs) @ [1, 1j]
        assert len(poles) == len(wanted)
        nearest = np.argmin(np.abs(poles[:, None] - wanted), axis=0)
        assert len(set(nearest)) == len(wanted), (gain, delay)
        np.testing.assert_allclose(poles[nearest], wanted, rtol=1e-9, atol=1e-15)


def simulated(gain: float, delay: float, noise: np.ndarray) -> np.ndarray:
    """Return the feature after a step of 50 px, by the simulated workstation, 1 s a frame."""
    wrong = iter(noise)
    stage, camera = (
        StageModel(1e50, increment=0.0, travel=1e50),
        CameraTiming(interval=1.0, latency=delay),
    )
    apparatus = {"jacobian": np.eye(2), "stage": stage, "camera": camera, "rng": 0}
    run = simulate(
        lambda k, measured, reference: gain * (reference[k] - measured),
        np.full((len(noise), 2), 50.0),
        start=(0.0, 0.0),
        observer=lambda feature: feature + next(wrong),
        **apparatus,
    )
    return run.feature[:, 0]


def test_browser_step_response_equals_simulated_workstation(tools: Page) -> None:
    loops = draw_loops()
    noise = np.random.default_rng(22).normal(0, 1, (COUNT, 40))
    found = tools.evaluate(
        "([loops, noise]) => loops.map(([g, d], k) => tryIt.loop.respond(g, d, 50, noise[k]))",
        [loops, noise.tolist()],
    )
    wanted = [simulated(g, d, row) for (g, d), row in zip(loops, noise, strict=True)]
    # Relative to the largest value of an answer: it crosses zero.
    largest = np.abs(wanted).max(axis=1, keepdims=True)
    np.testing.assert_allclose(found / largest, wanted / largest, rtol=0, atol=1e-9)


def test_browser_error_of_a_turned_camera_equals_library(tools: Page) -> None:
    times = np.linspace(0, 2, 9)
    for angle, rate in ((0, 2.0), (60, 0.7), (-35, 3.0), (100, 1.5)):
        wanted = turned_camera([angle], rate, times)[angle]
        found = tools.evaluate("all => tryIt.turn.path(...all)", [angle, rate, times.tolist()])
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9)


def test_browser_curvature_and_labels_equal_library(tools: Page) -> None:
    rng = np.random.default_rng(23)
    shape = (17, 19)
    y, x = np.mgrid[: shape[0], : shape[1]] - 8.0
    inputs = []
    for _ in range(COUNT // 4):  # every pixel of a map is an input, and its windows are random
        a, b, c, d, e = rng.uniform(-0.5, 0.5, 5)
        height = a * x**2 + b * x * y + c * y**2 + d * x + e * y + rng.normal(0, 0.3, shape)
        size = int(rng.choice([3, 5, 7]))
        inputs.append([height.ravel().tolist(), *shape, rng.uniform(0.5, 20), size, 0.3])
    found = tools.evaluate(
        """inputs => inputs.map(one => {
            const { surfaceCurvature, hkLabels } = tryIt.curvature;
            const found = surfaceCurvature(Float64Array.from(one[0]), ...one.slice(1));
            const labels = hkLabels(found.mean, found.gaussian, 0.02, 0.001);
            const plain = map => Array.from(map, v => Number.isNaN(v) ? null : v);
            const names = ["mean", "gaussian", "meanUncertainty", "gaussianUncertainty"];
            return [...names.map(name => plain(found[name])), labels];
        })""",
        inputs,
    )
    for one, (*fields, labels) in zip(inputs, found, strict=True):
        height, rows, cols, pitch, size, noise = one
        wanted = surface_curvature(np.reshape(height, (rows, cols)), pitch, size=size, noise=noise)
        names = ("mean", "gaussian", "mean_uncertainty", "gaussian_uncertainty")
        for name, field in zip(names, np.array(fields, float), strict=True):
            theirs = getattr(wanted, name).ravel()
            # K and H pass zero: what cancels there is measured by the map's largest value.
            most = np.nanmax(np.abs(theirs))
            np.testing.assert_allclose(field, theirs, rtol=1e-9, atol=1e-9 * most)
        assert labels == hk_labels(wanted.mean, wanted.gaussian, 0.02, 0.001).ravel().tolist()


def test_browser_depth_equals_library(tools: Page) -> None:
    frames, positions, height = render_stack()
    shown = tools.evaluate("tryIt.stack")
    assert shown["positions"] == positions.tolist()
    found = tools.evaluate(
        """() => {
            const { rows, cols, positions, data } = tryIt.stack;
            const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));
            const frames = data.map(text => ({ rows, cols, pixels: bytes(text) }));
            const measure = (frame, i) =>
                tryIt.focus.sumModifiedLaplacian(frame, i % cols, Math.floor(i / cols));
            const every = [...Array(rows * cols).keys()];
            return [every.map(i => measure(frames[3], i)), every.map(i =>
                tryIt.focus.gaussianPeak(frames.map(f => measure(f, i)), positions).depth)];
        }"""
    )
    measure, depth = (np.reshape(one, height.shape) for one in found)
    np.testing.assert_array_equal(measure, sum_modified_laplacian(frames[3], window=5))
    wanted = depth_from_focus(frames, positions, measure="sml", window=5).depth
    # The library's depths are of float32, seven digits of the stack's range.
    np.testing.assert_allclose(depth, wanted, rtol=0, atol=1e-4 * float(np.ptp(positions)))
    assert np.median(np.abs(depth - height)) < np.diff(positions)[0] / 2  # it is that dome


@pytest.mark.parametrize(("width", "theme"), [(1280, "dark"), (390, "light")])
def test_tools_are_accessible_in_every_state(
    page: Page, html: Path, width: int, theme: str
) -> None:
    page.add_init_script(f"localStorage.mode = '{theme}'; localStorage.theme = '{theme}'")
    open_page(page, html / "try.html", width, 844)
    page.locator("[data-try=modulus] summary").click()
    # 24 px is what WCAG 2.2 asks for at the least, 44 px what it recommends for a finger.
    controls = page.locator(".try :is(input, select, button, summary):visible")
    heights = controls.evaluate_all("all => all.map(one => one.getBoundingClientRect().height)")
    assert len(heights) > 40
    assert min(heights) >= 44
    answer = page.locator("[data-try=loop] .try-answer")
    before = answer.inner_text()
    page.get_by_label("Gain g (fraction of the error per frame)", exact=True).press("ArrowRight")
    assert answer.inner_text() != before
    page.get_by_label("Dimple depth (µm), exact").fill("2")  # no warning
    page.get_by_label("Gain g (fraction of the error per frame), exact").fill("1.05")  # unstable
    page.get_by_label("Surface", exact=True).select_option("Saddle")
    page.get_by_role("button", name="Set both thresholds").click()
    page.get_by_role("button", name="Go to the sharpest").click()
    assert hindrances(page) == []
    for label in ("Probe half-width c (µm), exact", "Delay (frames), exact", "Window (px), exact"):
        page.get_by_label(label).fill("1000")  # refused
    assert hindrances(page) == []
    assert page.evaluate("document.documentElement.scrollWidth - window.innerWidth") <= 0
    assert page.faults == []  # type: ignore[attr-defined]
