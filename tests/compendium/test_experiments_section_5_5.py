"""Section 5.5: rendered shapes come back from focus, and their types are what geometry says."""

import numpy as np
import pytest

from compendium import ledger, thesis
from compendium.experiments import section_5_5
from microlib.focus import sum_modified_laplacian
from microlib.synthetic import sphere_on_plane


@pytest.fixture(scope="module")
def ridge():
    return section_5_5.render_ridge(9, section_5_5.LABELED_WIDTH)


def fits(name: str, value: float) -> bool:
    """The number fulfills the sentence."""
    return not ledger.claim(f"section-5.5/{name}").objection(value, value, value)


def described_ridge(height: np.ndarray) -> np.ndarray:
    """Return a label map of the ridge as the thesis' sentences have it."""
    labels = np.full(height.shape, 5, np.uint8)
    labels[section_5_5.thesis_labels(height) == 2] = 2
    labels[50:53, 96:99], labels[90:93, 100:103] = 3, 1
    left, right = np.flatnonzero(height[0])[[0, -1]]
    labels[:, left - 4 : left - 1] = labels[:, right + 2 : right + 5] = 8
    return labels


def described_ball() -> np.ndarray:
    labels = np.full(section_5_5.BALL_SHAPE, 5, np.uint8)
    labels[section_5_5.from_ball_center() < 0.6] = 2
    labels[70:88, 70:110] = 8
    labels[90:94, 80:84], labels[100:104, 80:84] = 3, 9
    return labels


def of_sentences(ridge, change) -> dict[str, float]:
    """Return what is found in both described maps after a change of their labels."""
    found = section_5_5.ridge_sentences(ridge.height, change(described_ridge(ridge.height)))
    return found | section_5_5.ball_sentences(change(described_ball()))


def test_described_label_map_agrees_with_sentences(ridge):
    found = of_sentences(ridge, np.copy)
    assert all(fits(name, value) for name, value in found.items()), found


@pytest.mark.parametrize(
    ("fault", "wrong"),
    [
        (lambda t: np.full_like(t, 5), {"crest-convex-cylindric", "ball-top-cylindric"}),
        (lambda t: np.where(t == 8, 5, t), {"edge-concave-cylindric"}),
        (lambda t: np.where(np.indices(t.shape)[0] % 7 == 0, 1, t), {"sides-planar"}),
        # So many patches that they are not few.
        (lambda t: np.where(np.indices(t.shape)[0] % 8 < 2, 3, t), {"crest-saddle-and-elliptic"}),
        (lambda t: np.where(np.isin(t, (2, 8)), 6, t), {"ball-hyperbolic"}),
        (lambda t: np.where(np.indices(t.shape)[1] % 7 == 0, 2, t), {"ball-background-planar"}),
    ],
)
def test_changed_label_map_disagrees_with_sentences(ridge, fault, wrong):
    found = of_sentences(ridge, fault)
    assert wrong <= {name for name, value in found.items() if not fits(name, value)}


def test_ball_shape_distinguishes_cylinder_and_sphere():
    distance = section_5_5.from_ball_center()
    rise = np.sqrt(np.maximum(1 - distance**2, 0)) * section_5_5.BALL_RADIUS
    ball = distance < 1
    seen = np.where(ball, section_5_5.BALL_RADIUS + rise, 0)
    cone = 2 * section_5_5.BALL_RADIUS * np.maximum(1 - distance, 0)
    flat = np.where(ball, 2 * section_5_5.BALL_RADIUS, 0)
    for height, lower, top in ((seen, True, True), (cone, False, False), (flat, True, False)):
        found = section_5_5.ball_shape(height)
        assert fits("ball-lower-cylindric", found["ball-lower-cylindric"]) == lower
        assert fits("ball-top-spherical", found["ball-top-spherical"]) == top
    # A disc of whole pixels has the area of its circle to 1 %, its radius to half of that.
    assert max(section_5_5.ball_shape(seen).values()) < 0.05


def test_best_frame_is_nearest_to_fit(ridge):
    """The best frame by its own definition; at the ends of the stack there is no fit."""
    window = section_5_5.SML_WINDOW
    measures = [sum_modified_laplacian(frame, window=window) for frame in ridge.frames]
    best = ridge.positions[np.argmax(measures, axis=0)]
    found = section_5_5.thesis_depth(ridge.frames, ridge.positions)[1]
    step = np.diff(ridge.positions)[0]
    assert np.mean(step * np.rint(found / step) == best) > 0.999


def test_fit_is_better_and_wide_ridge_has_no_patches():
    both = section_5_5.ridge_map(9, (40.0, 100.0), (5.0,), runs=2).set_index("width")
    found = both[both["window"] == "printed"]
    assert (found["fit"] < found["best frame"]).all()
    assert found["all"].tolist() == [True, True, False, False]
    assert (found["spikes"] > found["corrected"]).all()
    wide = found.loc[100.0]
    assert (wide["crest-saddle-and-elliptic"] == 0).all()
    assert (wide["crest-convex-cylindric"] > 0.5).all()


def test_sentences_fail_with_corrected_window_as_their_rows_say():
    scenes = section_5_5.describe_scenes(5, 5)
    corrected = scenes["corrected"]
    kept = {
        name: fits(name, section_5_5.mean_interval(part)[1]) for name, part in corrected.items()
    }
    assert {name for name, holds in kept.items() if not holds} == {
        "crest-convex-cylindric",
        "ball-background-planar",
    }
    means = corrected.mean().round(2)
    assert means["sides-planar"] == 0.93
    assert means["crest-convex-cylindric"] == 0.37  # section-6/homogeneous-patches
    assert means["ball-background-planar"] == 0.84
    assert means["ball-top-cylindric"] == 0.66
    assert scenes["smooth-corrected"]["ball-hyperbolic"].max() == 0
    assert section_5_5.edge_by_ground(corrected=True) == 1.0
    mapped = section_5_5.ridge_map(5, (40.0, 60.0, 250.0), (0.0, 5.0), runs=5)
    noisy = mapped[mapped["noise"] == 5]
    assert (noisy["spikes"] > noisy["corrected"]).groupby(noisy["window"]).mean().min() > 0.5
    assert section_5_5.with_corrected_window(mapped, scenes) == pytest.approx(
        {
            "crest-least-printed": 0.61,
            "crest-most-printed": 0.92,
            "crest-least-corrected": 0.34,
            "crest-most-corrected": 0.49,
            "sides-least-printed": 0.94,
            "sides-least-corrected": 0.87,
            "all-corrected-60": 10,
            "ball-first-printed": 7,
            "ball-last-printed": 17,
            "ball-first-corrected": 10,
            "ball-last-corrected": 33,
            "ball-roughness-corrected": 0.61,
        },
        abs=0.005,
    )


@pytest.mark.parametrize(
    ("corrected", "share", "by_formula", "on_spheres"),
    [(True, 1.0, (8.2, 33.3), (10, 33)), (False, 0.5, (4.1, 16.7), (7, 17))],
)
def test_window_decides_which_balls_get_label_of_cylinder(corrected, share, by_formula, on_spheres):
    """The radii of the erratum on the thresholds; the printed window halves H at the top."""
    limits = share / np.sqrt(thesis.K_THRESHOLD), share / thesis.H_THRESHOLD
    assert limits == pytest.approx(by_formula, abs=0.05)
    tops = []
    for radius in range(2, 41):
        ball = sphere_on_plane((131, 131), float(radius), 1.0)
        tops.append(section_5_5.thesis_labels(ball, corrected=corrected)[65, 65])
    first, last = on_spheres
    assert tops == [1] * (first - 2) + [2] * (last - first + 1) + [5] * (40 - last)
