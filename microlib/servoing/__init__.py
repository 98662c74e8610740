"""Image-based visual servoing: Jacobian, controllers, metrics, and the loop over a microscope."""

from microlib.servoing._control import (
    OptimalController,
    ibvs_control,
    loop_poles,
    optimal_control,
    point_jacobian,
)
from microlib.servoing._metrics import PathMetrics, StepMetrics, path_metrics, step_metrics
from microlib.servoing._micromanager import MicroManager
from microlib.servoing._servo import ServoRun, servo
from microlib.servoing._simulated import SimulatedWorkstation
from microlib.servoing._workstation import CameraTiming, Simulation, StageModel, simulate

__all__ = [
    "CameraTiming",
    "MicroManager",
    "OptimalController",
    "PathMetrics",
    "ServoRun",
    "SimulatedWorkstation",
    "Simulation",
    "StageModel",
    "StepMetrics",
    "ibvs_control",
    "loop_poles",
    "optimal_control",
    "path_metrics",
    "point_jacobian",
    "servo",
    "simulate",
    "step_metrics",
]
