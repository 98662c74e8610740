"""What every caller relies on without writing it: defaults of arguments, and results that keep."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import pkgutil

import pytest

import microlib
from tests import fuzz

#: Every default of the public callables but None. A user who leaves an argument out gets another
#: result when its default changes: such a change belongs here and into the changelog.
DEFAULTS: dict[str, dict[str, object]] = {
    "automation.acquire_depth": {"timeout": 10.0},
    "automation.autofocus": {"timeout": 10.0},
    "automation.inject": {
        "law": "neo-hooke",
        "tolerance": 0.02,
        "approach_step": 0.5,
        "press_step": 10.0,
        "hold": 0.0,
        "direction": "auto",
        "most_lost": 3,
        "timeout": 10.0,
        "keep_frames": False,
    },
    "batch.process_files": {"workers": 1, "retry": False},
    "calibration.Calibration.interval": {"level": 0.95},
    "calibration.Calibration.um_per_pixel": {"level": 0.95},
    "calibration.calibrate": {"loss": "linear"},
    "calibration.detect_circles": {
        "direction": 0.0,
        "mirrored": False,
        "lattice": "square",
        "origin": "first",
    },
    "calibration.detect_squares": {"direction": 0.0, "mirrored": False, "pattern": "squares"},
    "curvature.curvature_windows": {"size": 7},
    "curvature.surface_curvature": {"size": 7, "noise": 0.0},
    "embryo.extract_boundary": {"direction": "auto", "dimple": True},
    "embryo.fit_gaussians": {"terms": 8, "max_iterations": 1500},
    "embryo.force_from_image": {"direction": "auto"},
    "embryo.force_over_time": {"modulus_std": 0.0, "direction": "auto"},
    "embryo.loess": {"span": 0.25, "degree": 2, "robust_iterations": 0},
    "embryo.measure_dimple": {"method": "membrane"},
    "embryo.modulus_from_image": {"method": "membrane", "law": "neo-hooke", "direction": "auto"},
    "focus.correct_spikes": {"window": 9, "delta": 2.0},
    "focus.depth_from_focus": {
        "measure": "multiscale",
        "window": 5,
        "step": 1,
        "threshold": 0.0,
        "workers": 1,
        "register": False,
        "reduce": 1,
    },
    "focus.depth_to_zarr": {"tile": 1024, "points": 7, "workers": 1},
    "focus.smooth_depth": {"radius": 7.0},
    "focus.survey_focus": {"workers": 1},
    "focus.sum_modified_laplacian": {"window": 5, "step": 1, "threshold": 0.0},
    "io._frames.FrameReader.again": {"color": False},
    "io.read_frames": {"color": False, "reduce": 1},
    "io.write_height_tiff": {"what": "height in um"},
    "io.write_ply": {"step": 1},
    "membrane.capsule_bending_force": {
        "poisson_ratio": 0.5,
        "law": "neo-hooke",
        "inflation": 1.0,
        "support": "plate",
    },
    "membrane.capsule_modulus": {
        "poisson_ratio": 0.5,
        "law": "neo-hooke",
        "support": "plate",
        "punch": "bonded",
    },
    "membrane.disc_modulus": {
        "poisson_ratio": 0.5,
        "law": "neo-hooke",
        "pressure": "balance",
        "pretension": 0.0,
        "rim_inset": 0.0,
    },
    "membrane.fit_capsule": {
        "poisson_ratio": 0.5,
        "law": "neo-hooke",
        "support": "plate",
        "punch": "bonded",
        "fit_tilt": False,
    },
    "membrane.indent_capsule": {
        "poisson_ratio": 0.5,
        "law": "neo-hooke",
        "inflation": 1.0,
        "support": "plate",
        "punch": "bonded",
    },
    "membrane.indent_disc": {
        "poisson_ratio": 0.5,
        "law": "neo-hooke",
        "pressure": "balance",
        "pretension": 0.0,
        "rim_inset": 0.0,
    },
    "membrane.mean_strain": {"small_slopes": True},
    "microscope.Microscope": {
        "distortion": 0.0,
        "alpha": 0.0,
        "beta": 0.0,
        "gamma": 0.0,
        "tx": 0.0,
        "ty": 0.0,
        "pixel_size": 9.9,
        "image_size": (656, 491),
    },
    "servoing.Camera": {"latency": 0.0, "jitter": 0.0},
    "servoing.PredictiveController": {"innovation_gain": 0.3},
    "servoing.SimulatedWorkstation": {"home": (0.0, 0.0), "drift": (0.0, 0.0)},
    "servoing.Stage": {"lag": 0.0, "step": 0.05, "travel": 7500.0},
    "servoing.loop_poles": {"delay": 0.0},
    "servoing.servo": {
        "unit": "px",
        "path": False,
        "drive": "position",
        "tolerance": 0.05,
        "interval": 0.1,
        "rest": 0.0,
        "most_frames": 50,
        "most_lost": 3,
        "timeout": 10.0,
        "keep_frames": False,
    },
    "servoing.step_metrics": {"band": 0.05},
    "synthetic.Embryo": {
        "thickness": 3.0,
        "probe_half_width": 25.0,
        "poisson_ratio": 0.5,
        "radius": 600.0,
    },
    "synthetic.Embryo.dented": {"rim_radius": 450.0},
    "synthetic.Embryo.outline": {"spacing": 0.25},
    "synthetic.Embryo.pressed": {"rim_radius": 450.0},
    "synthetic.ImagingConditions": {
        "blur": 1.0,
        "dark": 50.0,
        "bright": 200.0,
        "vignetting": 0.0,
        "gradient": (0.0, 0.0),
        "noise": 0.0,
    },
    "synthetic._gripper.GripperScene.box": {"shift": (0.0, 0.0)},
    "synthetic._gripper.GripperScene.frame": {"noise": 2.0, "gain": 1.0},
    "synthetic.InjectionScene": {
        "radius": 600.0,
        "thickness": 3.0,
        "probe_half_width": 25.0,
        "inflation": 1.05,
        "law": "neo-hooke",
        "strongest": 100.0,
        "pixel_size": 3.875,
        "shape": (260, 360),
        "noise": 2.0,
    },
    "synthetic.camera_frame": {"gain": 1.0},
    "synthetic.cell_image": {"count": 14, "pixel_size": 0.25, "shape": (360, 480)},
    "synthetic.embryo_image": {
        "pixel_size": 3.875,
        "shape": (768, 1024),
        "tilt": 0.0,
        "blur": 1.0,
        "noise": 2.0,
        "unevenness": 0.1,
        "probe": True,
    },
    "synthetic.embryo_sequence": {"rim_radius": 450.0},
    "synthetic.focal_stack": {"sharpest": 0.5, "noise": 0.0},
    "synthetic.gripper_scene": {"gap": 100.0, "shape": (240, 320), "reach": 80},
    "synthetic.mixed_texture": {"mean": 128.0, "std": 38.0, "scales": (0.6, 1.2, 2.4, 4.8, 9.6)},
    "synthetic.patchy_texture": {"mean": 128.0, "std": 38.0, "weakest": 0.05, "patch": 24.0},
    "synthetic.quadric_patch": {"half": 20, "radius": 40.0},
    "synthetic.render_circles": {"radius": 70.0, "pitch": 280.0},
    "synthetic.render_squares": {"side": 200.0},
    "synthetic.sphere_on_plane": {"roughness": 0.0, "grain": 5.0},
    "synthetic.step": {"at": 0.5},
    "synthetic.texture_sequence": {"size": 50, "sigma": 1.0, "noise": 2.0},
    "synthetic.warped_pair": {
        "warp": "shift",
        "size": 50,
        "sigma": 1.0,
        "noise": 2.0,
        "gain": 1.05,
    },
    "tracking.ESMTracker": {"motion": "homography", "smoothing": 1.25, "least_correlation": 0.7},
}
#: Defaults that are not single values: all parameters of the model.
_COMPUTED = {"microscope.Microscope.jacobian"}


@pytest.mark.parametrize("name", sorted(set(fuzz.public()) - _COMPUTED))
def test_defaults_are_those_that_are_listed(name: str) -> None:
    given = inspect.signature(fuzz.resolve(name)).parameters.values()
    found = {p.name: p.default for p in given if p.default not in (p.empty, None)}
    listed = DEFAULTS.get(name, {})
    assert set(found) == set(listed), f"list in DEFAULTS: {name!r}: {found}"
    for argument, value in listed.items():
        assert type(found[argument]) is type(value), argument
        # Some are quotients of round numbers, good to rounding.
        same = pytest.approx(value, rel=1e-12) if isinstance(value, float) else value
        assert found[argument] == same, argument


def test_no_default_is_listed_of_what_is_not_public() -> None:
    assert set(DEFAULTS) <= set(fuzz.public())


def test_records_cannot_be_changed() -> None:
    """A result is handed on, and a setting is checked once, when it is made."""
    kinds = set()
    for info in pkgutil.walk_packages(microlib.__path__, "microlib."):
        found = vars(importlib.import_module(info.name)).values()
        kinds |= {
            each for each in found if inspect.isclass(each) and dataclasses.is_dataclass(each)
        }
    assert len(kinds) > 30
    assert not [kind for kind in kinds if not kind.__dataclass_params__.frozen]
