"""steering: planner, tip estimator and the step that joins them, as pure functions."""

from labrig.steering.estimator import estimate_tip_poses
from labrig.steering.planner import plan_path

__all__ = ["estimate_tip_poses", "plan_path"]
