"""What blocks say of a pose, against weighted sums of NumPy's, and where the box lies."""

from __future__ import annotations

import numpy as np
import pytest

from microlib.tracking import ESMTracker
from microlib.tracking._blocks import agreement, edges
from microlib.tracking._light import _explained


def by_numpy(grey, template, share, noise):
    """Agreement as its docstring and the constants' comments have it, block by block."""
    down, across = edges(grey.shape[0]), edges(grey.shape[1])
    places = [
        (slice(down[j], down[j + 2]), slice(across[i], across[i + 2]))
        for j in range(len(down) - 2)
        for i in range(len(across) - 2)
    ]
    rows = []
    for place in places:
        w, t, g = (np.asarray(a[place], float).ravel() for a in (share, template, grey))
        seen = w.sum()
        w = w / max(seen, 1e-9)
        tv, gv = w @ t**2 - (w @ t) ** 2, w @ g**2 - (w @ g) ** 2
        both = w @ (t * g) - (w @ t) * (w @ g)
        square = both**2 / (tv * gv) if both > 0 else 0.0
        rows.append((seen, gv, gv * (1 - square), -0.5 * np.log(1 - square), both / tv))
    seen, variance, residual, information, slope = np.array(rows).T
    seen = seen / seen.max()
    gain = np.log(np.clip(slope, 1e-2, 1e2))
    weight = np.where(information > 0.25, information * seen, 0)
    order = np.argsort(gain)
    middle = gain[order][np.searchsorted(np.cumsum(weight[order]), weight.sum() / 2)]
    expected = 2 * noise**2
    says = information - 0.25 - (gain - middle) ** 2
    score = (np.maximum(says, 0) * seen / (1 + residual / expected / 9)).sum()
    say = np.clip(variance / expected - 1, 0, 50) * seen
    fine = residual <= 3 * expected + 0.02 * variance
    return score, (says > 0).mean(), say[fine].sum() / say.sum(), say.sum()


@pytest.mark.parametrize("noise", [2.0, 6.0])
def test_blocks_say_what_their_sums_say(noise):
    rng = np.random.default_rng(1)
    template = rng.normal(100, 30, (40, 52)).astype(np.float32)
    template[25:] = 100 + rng.normal(0, 4, (15, 52))  # hardly any texture
    grey = (1.2 * template + 5 + rng.normal(0, noise, template.shape)).astype(np.float32)
    grey[:18, :20] = rng.normal(100, 30, (18, 20))  # something else
    grey[8:24, 30:] += rng.normal(0, 12, (16, 22)).astype(np.float32)  # the same, badly seen
    share = np.ones(template.shape, np.float32)
    share[:, 40:] = 0.4
    found = agreement(grey, template, share, noise)
    expected = by_numpy(grey, template, share, noise)
    assert 0.1 < expected[2] < 0.9
    # Sums of single precision over blocks of 100 px: 1e-7 of squares of 10 times the variance.
    np.testing.assert_allclose(
        [found.score, found.share, found.agreeing, found.texture], expected, rtol=1e-3
    )


def test_what_is_explained_is_the_correlation_of_the_model():
    rng = np.random.default_rng(2)
    model, weight = rng.normal(90, 20, 400), rng.uniform(0, 1, 400)
    grey = model + rng.normal(0, 15, 400)
    # Of a regression by the same weights the residual is uncorrelated, and 1 − R² its share.
    design = np.column_stack([np.ones(400), model]) * np.sqrt(weight)[:, None]
    best = np.linalg.lstsq(design, grey * np.sqrt(weight), rcond=None)[0]
    residual = grey - best[0] - best[1] * model
    covariance = np.cov(grey, model, aweights=weight)
    r = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    assert _explained(grey, residual, weight) == pytest.approx(r, rel=1e-12)


def test_a_box_of_any_proportions_begins_in_its_middle():
    image = np.random.default_rng(3).uniform(0, 255, (70, 90)).astype(np.uint8)
    for box in ((10, 12, 40, 24), (20, 8, 24, 41)):
        track = ESMTracker(image, box, "translation").track(image)
        x, y, width, height = box
        # A hundredth of a pixel is far more than what the search leaves on the image itself.
        assert track.center == pytest.approx((x + (width - 1) / 2, y + (height - 1) / 2), abs=0.01)
