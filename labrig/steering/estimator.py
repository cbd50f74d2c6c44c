"""Poses of the tip from its positions: step by step for the live loop, or a whole insertion at once."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ValidationError

from labrig.errors import InputError
from labrig.needle.kinematics import FloatArray
from labrig.steering.error_state import step_error_state
from labrig.steering.paper_filter import step_paper_filter
from labrig.steering.parameters import EstimatorMethod
from labrig.steering.tip import (
    CURVATURE,
    EstimatorSettings,
    TipObservation,
    TipState,
    freeze,
    require_numbers,
    require_pose,
)

# Of the sheath's direction, for positions alone.
_START_SD_RAD = 0.02


def start_tip(pose: FloatArray, settings: EstimatorSettings) -> TipState:
    """Return the tip at its start: its position is as good as an observation, its orientation as `start_sd_rad`.

    Parameters
    ----------
    pose : (4, 4) array
    settings : EstimatorSettings
    """
    curvature = 1.0 / settings.radius_mm
    sd = np.array([settings.observation_sd_mm] * 3 + [settings.start_sd_rad] * 3 + [0.0, settings.slip_sd])
    sd[CURVATURE] = settings.radius_sd_mm * curvature**2
    variances = np.zeros(settings.size)
    variances[list(settings.errors)] = sd[list(settings.errors)] ** 2
    return TipState(
        freeze(np.array(pose[:3, :3], dtype=np.float64)),
        freeze(np.array(pose[:3, 3], dtype=np.float64)),
        curvature,
        freeze(np.diag(variances)),
        nis=None,
        accepted=False,
        misses=0,
    )


def step_tip(state: TipState, observation: TipObservation, settings: EstimatorSettings) -> TipState:
    """Return the tip after one observation: the needle rolls, advances, and is then seen or missed."""
    step = step_paper_filter if settings.method == "paper" else step_error_state
    return step(state, observation, settings)


def estimate_tip_poses(  # noqa: PLR0917 - callers rely on the order
    positions_mm: ArrayLike,
    step_mm: float,
    roll_rad: ArrayLike,
    radius_mm: float,
    observation_sd_mm: float,
    process_sd_rad: float,
    method: EstimatorMethod = "error-state",
    start: ArrayLike | None = None,
) -> FloatArray:
    """Return the poses of the tip at each observed position.

    Parameters
    ----------
    positions_mm : (T + 1, 3) array
    step_mm : float
        Inserted between one position and the next.
    roll_rad : (T,) array
        The roll applied before each step; the needle turns first, then advances.
    radius_mm : float
    observation_sd_mm : float
        Of a position, along each axis.
    process_sd_rad : float
        Of the random turning of the tip in one step, about each of its axes.
    method : {"error-state", "paper"}
        The default filter, or the paper's as corrected.
    start : (4, 4) array or None
        The pose at the first position; None: along z, with the bevel at roll 0.

    Returns
    -------
    (T + 1, 4, 4) array
        T_w_t. The first is the start, improved by the first position.

    Raises
    ------
    InputError
        For a wrong shape, a number that is not finite or out of its range, or a start that is not a pose.
    """
    positions = require_numbers("positions_mm", positions_mm, (None, 3))
    if len(positions) == 0:
        raise InputError("positions_mm is empty", "give at least the tip's position at the start")
    rolls = require_numbers("roll_rad", roll_rad, (len(positions) - 1,))
    if not (math.isfinite(step_mm) and step_mm > 0.0):
        raise InputError(f"step_mm is {step_mm:g}, it must be above 0")
    try:
        settings = EstimatorSettings(
            method=method,
            observation_sd_mm=observation_sd_mm,
            process_sd_deg_per_root_mm=math.degrees(process_sd_rad / math.sqrt(step_mm)),
            radius_sd_mm=0.0,
            start_sd_deg=math.degrees(_START_SD_RAD),
            cavity_every_mm=None,
            slip_sd=0.0,
            radius_mm=radius_mm,
        )
    except ValidationError as error:
        wrong = (f"{fault['loc'][0]} is {fault['input']}: {fault['msg']}" for fault in error.errors())
        raise InputError("; ".join(wrong)) from error
    pose = np.eye(4)
    pose[:3, 3] = positions[0]
    if start is None:
        state = start_tip(pose, settings)
    else:
        state = start_tip(require_pose("start", start), settings)
        state = replace(step_tip(state, TipObservation(positions[0], 0.0), settings), misses=0)
    poses = [state.pose]
    for position, roll in zip(positions[1:], rolls, strict=True):
        state = step_tip(state, TipObservation(position, step_mm, float(roll)), settings)
        poses.append(state.pose)
    return np.stack(poses)
