"""Follow a template through frames by efficient second-order minimisation (ESM)."""

from microlib.tracking._kalman import KalmanFilter
from microlib.tracking._tracker import ESMTracker, Track

__all__ = ["ESMTracker", "KalmanFilter", "Track"]
