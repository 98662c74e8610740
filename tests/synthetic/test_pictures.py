"""A seed keeps its picture: records and benchmarks are compared across versions of the library.

Each case is drawn anew and held against ``pictures.json``: means over sixteen parts, and the
scatter. Where a picture is meant to change, ``python -m tests.synthetic.test_pictures`` writes the
file again, and the changelog says so.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from microlib import synthetic
from microlib.microscope import Microscope

RECORD = Path(__file__).with_name("pictures.json")
#: Grey levels: OpenCV's releases round outlines and filters by less, means over hundreds of pixels.
TOLERANCE = 0.1
SCOPE = Microscope(
    200490, 126150, 78750, distortion=-2e-9, alpha=0.3, beta=-0.05, gamma=3.07, tx=-781.4,
    ty=-55.0, pixel_size=(9.9, 12.0), image_size=(160, 120),
)  # fmt: skip
LIGHT = synthetic.ImagingConditions(
    blur=1.4, dark=40.0, bright=190.0, vignetting=0.3, gradient=(0.2, -0.1), noise=3.0
)
EGG = synthetic.Embryo.pressed(150.0, modulus=1.0)
THIN = synthetic.Embryo.dented(
    90.0, modulus=2.0, rim_radius=300.0, radius=500.0, thickness=5.0, probe_half_width=20.0,
    poisson_ratio=0.4,
)  # fmt: skip
RAMP = np.add.outer(np.arange(40.0), np.arange(48.0))


def egg_of(embryo: synthetic.Embryo, **options: object) -> NDArray:
    settings = {"pixel_size": 7.75, "shape": (200, 256)} | options
    return synthetic.embryo_image(embryo, rng=3, **settings).image  # type: ignore[arg-type]


def warped(kind: str) -> NDArray:
    pair = synthetic.warped_pair(4, 3.0, warp=kind, size=24)
    return np.hstack([pair.first, pair.second])


def gripped(**options: object) -> NDArray:
    settings = {"pixel_size": 4.0, "shape": (120, 160), "reach": 30} | options
    scene = synthetic.gripper_scene(5, **settings)  # type: ignore[arg-type]
    return scene.frame((7.3, -4.6), 6)


CASES: dict[str, Callable[[], NDArray]] = {
    "mixed texture": lambda: synthetic.mixed_texture((40, 56), 1),
    "mixed texture, other": lambda: synthetic.mixed_texture(
        (40, 56), 1, mean=90.0, std=20.0, scales=(0.8, 5.0)
    ),
    "patchy texture": lambda: synthetic.patchy_texture((60, 80), 2),
    "patchy texture, other": lambda: synthetic.patchy_texture(
        (60, 80), 2, mean=90.0, std=20.0, weakest=0.3, patch=6.0
    ),
    "circles": lambda: synthetic.render_circles(SCOPE),
    "circles, few": lambda: synthetic.render_circles(
        SCOPE, radius=50.0, pitch=220.0, counts=(3, 2), imaging=LIGHT, rng=7
    ),
    "squares": lambda: synthetic.render_squares(SCOPE),
    "squares, few": lambda: synthetic.render_squares(
        SCOPE, side=120.0, counts=(2, 3), imaging=LIGHT, rng=8
    ),
    "293T": lambda: synthetic.cell_image("293T", rng=9).image,
    "Jurkat": lambda: synthetic.cell_image(
        "Jurkat", rng=9, count=5, pixel_size=0.4, shape=(200, 240)
    ).image,
    "embryo": lambda: egg_of(EGG),
    "embryo, tilted": lambda: egg_of(EGG, tilt=0.15, center=(120.0, 45.0), blur=2.0, noise=5.0),
    "embryo without a probe": lambda: egg_of(EGG, probe=False, unevenness=0.3),
    "another embryo": lambda: egg_of(THIN, pixel_size=6.0, shape=(220, 280)),
    "embryos": lambda: synthetic.embryo_sequence([80.0], modulus=1.0, rng=1)[0].image,
    "stack": lambda: np.hstack(
        list(
            synthetic.focal_stack(
                synthetic.mixed_texture((40, 48), 1), RAMP / 10, [0.0, 4.0, 8.0],
                blur_rate=0.8, noise=2.0, rng=1,
            )
        )
    ),
    "shift": lambda: warped("shift"),
    "affine": lambda: warped("affine"),
    "homography": lambda: warped("homography"),
    "moving square": lambda: np.hstack(
        synthetic.texture_sequence([[5.0, 4.0], [7.4, 9.7]], 2, size=20)
    ),
    "gripper": gripped,
    "gripper, open": lambda: gripped(gap=150.0, pixel_size=5.0),
    "camera": lambda: synthetic.camera_frame(RAMP + 40, 3, noise=4.0, gain=1.2),
}  # fmt: skip


def signature(image: NDArray) -> list[float]:
    """Return means over four by four parts, then the standard deviation."""
    rows = np.array_split(np.asarray(image, float), 4, axis=0)
    parts = [part for row in rows for part in np.array_split(row, 4, axis=1)]
    return [*(float(part.mean()) for part in parts), float(np.std(image))]


def test_a_pattern_may_be_black_on_white():
    light = synthetic.ImagingConditions(blur=0.0, dark=0, bright=255)
    image = synthetic.render_squares(SCOPE, imaging=light)
    assert (image.min(), image.max()) == (0, 255)
    for name in ("dark", "bright"):
        with pytest.raises(ValueError, match=f"{name} must lie in"):
            synthetic.ImagingConditions(**{name: 255.5})


def test_a_pixel_in_the_very_middle_of_a_square_is_dark():
    """Its middle is as far from either side: that leaked a division by zero."""
    straight = Microscope(200000.0, 126000.0, 79380.0, tx=-60.0, ty=-60.0, image_size=(21, 21))
    image = synthetic.render_squares(straight, side=120.0)
    assert straight.project([[60.0, 60.0]]).round(9).tolist() == [[10.0, 10.0]]
    assert image[10, 10] == image.min()


@pytest.mark.parametrize("name", CASES)
def test_a_seed_keeps_its_picture(name: str) -> None:
    record = json.loads(RECORD.read_text(encoding="utf-8"))
    assert set(record) == set(CASES)
    np.testing.assert_allclose(signature(CASES[name]()), record[name], rtol=0, atol=TOLERANCE)


def write() -> None:
    found = {name: [round(value, 3) for value in signature(draw())] for name, draw in CASES.items()}
    lines = [f"  {json.dumps(name)}: {json.dumps(values)}" for name, values in found.items()]
    RECORD.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    write()
