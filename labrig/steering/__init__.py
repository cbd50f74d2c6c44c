"""steering: planner, tip estimator and the step that joins them, as pure functions."""

from labrig.steering.estimator import estimate_tip_poses, start_tip, step_tip
from labrig.steering.planner import Plan, PlannedArc, plan_path, sample_path
from labrig.steering.policy import (
    SteeringCommand,
    SteeringPolicy,
    SteeringSettings,
    StopReason,
    TipSighting,
)
from labrig.steering.problem import Obstacle, PlanMethod, PlanProblem, PlanWeights
from labrig.steering.roll_zero import RollZeroFit, fit_roll_zero
from labrig.steering.step import SteeringState, sighted, start_steering, step_steering, turned
from labrig.steering.tip import EstimatorMethod, EstimatorSettings, TipObservation, TipState

__all__ = [
    "EstimatorMethod",
    "EstimatorSettings",
    "Obstacle",
    "Plan",
    "PlanMethod",
    "PlanProblem",
    "PlanWeights",
    "PlannedArc",
    "RollZeroFit",
    "SteeringCommand",
    "SteeringPolicy",
    "SteeringSettings",
    "SteeringState",
    "StopReason",
    "TipObservation",
    "TipSighting",
    "TipState",
    "estimate_tip_poses",
    "fit_roll_zero",
    "plan_path",
    "sample_path",
    "sighted",
    "start_steering",
    "start_tip",
    "step_steering",
    "step_tip",
    "turned",
]
