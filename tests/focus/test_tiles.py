"""Tiles have the depth of the whole image, to the last bit."""

import numpy as np
import pytest

from microlib import synthetic
from microlib.focus import _depth, _survey, depth_from_focus, survey_focus
from microlib.focus._measures import blur
from microlib.focus._nearest import enlarged, halved
from microlib.focus._window import Window

COUNT = 11
POSITIONS = np.arange(float(COUNT))
#: Long enough for tiles that do not see all of it: a tile looks at some 500 px to either side.
LONG = (33, 1401)
MAPS = ("depth", "uncertainty", "confidence", "index", "all_in_focus", "at_end")


def stack_of(kind, seed=0, shape=LONG, noise=2.0):
    """A strip with slopes, steps and waves, and bare ground with strokes that have halos."""
    y, x = np.indices(shape)
    rng = np.random.default_rng(seed)
    height = {
        "slope": 2 + synthetic.tilted_plane(shape, 7 / shape[1], 0.01),
        "steps": 2.2 + 6.0 * ((x // 97) % 2),
        "waves": 5 + 3.5 * np.sin(x / 190) * np.cos(y / 70),
    }[kind.split()[0]]
    texture = synthetic.mixed_texture(shape, rng)
    if "bare" in kind:
        bare = (np.sin(x / 60 + seed) * np.sin(y / 50 + 1) > 0.3) | (np.sin(x / 333 + seed) > 0.8)
        texture = np.where(bare, texture.mean(), texture)
        texture[10:-10][:, x[0] % 90 < 6] = 250.0
    return synthetic.focal_stack(texture, height, POSITIONS, blur_rate=1.0, noise=noise, rng=rng)


def assert_same(part, whole, at=(slice(None), slice(None))):
    for name in MAPS:
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[at], name)


@pytest.mark.parametrize(
    ("kind", "tile"), [("slope", 128), ("steps", 1000), ("steps bare", 256), ("waves bare", 128)]
)
def test_tiles_are_the_whole_to_the_bit(kind, tile):
    stack = stack_of(kind, seed=tile)
    whole = depth_from_focus(stack, POSITIONS)
    assert_same(depth_from_focus(stack, POSITIONS, tile=tile, workers=2), whole)


def test_tiles_of_columns_of_other_types_and_of_averaged_frames_too():
    stack = np.repeat(stack_of("waves bare", seed=3).transpose(0, 2, 1), 2, axis=0)
    stack = stack.astype(np.uint16) * 17
    positions = np.arange(float(len(stack)))
    whole = depth_from_focus(stack, positions)
    assert_same(depth_from_focus(stack, positions, tile=700), whole)


def test_a_region_with_a_survey_is_that_of_the_whole_image():
    stack = stack_of("steps bare", seed=4)
    survey = survey_focus(stack, POSITIONS)
    whole = depth_from_focus(stack, POSITIONS)
    part = depth_from_focus(stack, POSITIONS, survey=survey, region=(7, 701, 20, 90))
    assert_same(part, whole, np.s_[7:27, 701:791])
    assert survey.noise == pytest.approx(2.0, rel=0.2)
    alone = depth_from_focus(stack[:, 7:27, 701:791], POSITIONS)
    assert (alone.depth != part.depth).any()


class Lazy:
    """What zarr and dask arrays have in common; adds up what is loaded."""

    def __init__(self, values):
        self._values, self.shape, self.dtype = values, values.shape, values.dtype
        self.loaded = 0

    def __getitem__(self, key):
        found = self._values[key]
        self.loaded = max(self.loaded, found.size)
        return found


def test_of_a_lazy_array_only_the_tile_and_its_surroundings_are_loaded(monkeypatch):
    stack = stack_of("slope", seed=5)
    lazy = Lazy(stack)
    monkeypatch.setattr(_survey, "MOST_PIXELS", 1000)
    monkeypatch.setattr(_depth, "MOST_PIXELS", 1000)
    told = []
    found = depth_from_focus(
        lazy, POSITIONS, tile=64, progress=lambda done, count: told.append((done, count))
    )
    assert lazy.loaded <= 33 * (64 + 2 * 544)
    assert told == [(k + 1, 22) for k in range(22)]
    # A generator is kept, and one as large without a tile has the same survey.
    assert_same(depth_from_focus(iter(stack), POSITIONS, tile=500), found)
    assert_same(depth_from_focus(stack, POSITIONS), found)


def test_patches_stand_for_a_large_image(monkeypatch):
    """Depths and errors by a survey of patches are those by one of all pixels."""
    stack = stack_of("waves", seed=6, shape=(200, 500))
    whole = depth_from_focus(stack, POSITIONS)
    monkeypatch.setattr(_survey, "MOST_PIXELS", 1000)
    monkeypatch.setattr(_depth, "MOST_PIXELS", 1000)
    patches = depth_from_focus(stack, POSITIONS)
    # Both are estimates of the same, from thousands of pixels: a tenth of the depth's own error.
    difference = (patches.depth - whole.depth)[np.isfinite(whole.depth)]
    assert np.sqrt(np.mean(difference**2)) < 0.1 * np.nanmedian(whole.uncertainty)
    assert np.nanmedian(patches.uncertainty / whole.uncertainty) == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize("sigma", [0.8, 3.0, 4.0, 6.0, 14.0, 30.0])
def test_a_mean_does_not_depend_on_where_the_image_begins(sigma):
    image = np.random.default_rng(0).random((230, 260)).astype(np.float32)
    reach = 2 * round(2 * sigma + 2)
    part = blur(image[13:, 7:], sigma)[reach:, reach:]
    np.testing.assert_array_equal(part, blur(image, sigma)[13 + reach :, 7 + reach :])
    far = np.zeros((400, 1), np.float32)
    far[:100] = 1e6
    assert not blur(far, sigma)[300:].any()  # running sums leave something


def test_half_and_twice_the_size_begin_at_the_first_pixel():
    image = np.arange(35.0, dtype=np.float32).reshape(5, 7)
    half = halved(image)
    assert half.shape == (3, 4)
    assert half[0, 0] == image[:2, :2].mean()
    assert half[2, 3] == image[4, 6]
    twice = enlarged(np.tile(np.arange(4.0, dtype=np.float32), (3, 1)), (5, 7))
    np.testing.assert_allclose(twice[2], [0, 0.25, 0.75, 1.25, 1.75, 2.25, 2.75])


def test_a_window_knows_its_border():
    window = Window(32, 0, 64, 30, (100, 31))
    down, along = window.border()
    assert (down[0], down[-1], along[0], along[-1]) == (32, 36, 0, 1)
    np.testing.assert_array_equal(window.border(2)[0], [*range(16, 25), *range(24, 17, -1)])
    outer = window.grown(40)
    assert (outer.top, outer.bottom, outer.right) == (0, 100, 31)
    assert window.inside(outer, 2) == (slice(16, 32), slice(0, 15))


def test_what_does_not_go_with_tiles_is_refused():
    stack = stack_of("slope", shape=(30, 40))
    survey = survey_focus(stack, POSITIONS)
    for words, change in (
        ("measure 'sml'", {"tile": 64, "measure": "sml"}),
        ("no register", {"tile": 64, "register": True}),
        ("tile must be a whole number of at least", {"tile": 3}),
        ("points must be 7 as in survey, got 5", {"survey": survey, "points": 5}),
        ("region must lie in frames", {"survey": survey, "region": (20, 0, 20, 20)}),
        ("region must be top, left", {"survey": survey, "region": (20, 0)}),
        ("survey must be of the kind FocusSurvey", {"survey": 3}),
    ):
        with pytest.raises(ValueError, match=words):
            depth_from_focus(stack, POSITIONS, **change)
    with pytest.raises(ValueError, match="survey must be of these frames"):
        depth_from_focus(stack, POSITIONS + 1, survey=survey)
    with pytest.raises(ValueError, match="survey must be of these frames"):
        depth_from_focus(stack[:, 1:], POSITIONS, survey=survey)
    color = np.repeat(stack[..., None], 3, axis=3)
    with pytest.raises(ValueError, match="grey frames"):
        depth_from_focus(color, POSITIONS, tile=64)
    with pytest.raises(ValueError, match="frames must be grey"):
        survey_focus(color, POSITIONS)
