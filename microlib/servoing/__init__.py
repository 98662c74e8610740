"""Image-based visual servoing: Jacobian, controllers, metrics, a simulated workstation."""

from microlib.servoing._control import (
    OptimalController,
    PredictiveController,
    ibvs_control,
    loop_poles,
    optimal_control,
    point_jacobian,
)
from microlib.servoing._metrics import path_metrics, step_metrics
from microlib.servoing._workstation import Camera, Stage, simulate, tracked_view

__all__ = [
    "Camera",
    "OptimalController",
    "PredictiveController",
    "Stage",
    "ibvs_control",
    "loop_poles",
    "optimal_control",
    "path_metrics",
    "point_jacobian",
    "simulate",
    "step_metrics",
    "tracked_view",
]
