"""Image-based visual servoing: Jacobian, controllers, metrics, a simulated workstation."""

from microlib.servoing._control import (
    OptimalController,
    PredictiveController,
    ibvs_control,
    loop_poles,
    optimal_control,
    optimal_gain,
    point_jacobian,
)
from microlib.servoing._metrics import (
    circle_path,
    path_metrics,
    sinusoid_path,
    square_path,
    step_metrics,
)
from microlib.servoing._workstation import Camera, Simulation, Stage, simulate, tracked_view

__all__ = [
    "Camera",
    "OptimalController",
    "PredictiveController",
    "Simulation",
    "Stage",
    "circle_path",
    "ibvs_control",
    "loop_poles",
    "optimal_control",
    "optimal_gain",
    "path_metrics",
    "point_jacobian",
    "simulate",
    "sinusoid_path",
    "square_path",
    "step_metrics",
    "tracked_view",
]
