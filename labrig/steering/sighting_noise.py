"""How precisely the tip was seen, and the play of the hinges, from the sightings of an insertion themselves.

The estimator predicts each sighting from those before it. The measured values are those under which all sightings of
the insertion were the most probable (maximum likelihood by prediction errors, Schweppe 1965). So they hold whatever
the estimator does not model: a template that reads a bent tip off its place shows as noise of the sightings.

The mean NIS tells whether the stated settings fit: in the plane it is 2 where they do, smaller where the tip is seen
better than they say, and larger where it is seen worse or moves otherwise (Bar-Shalom, Li and Kirubarajan 2001, section
5.4).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import gammaincinv

from labrig.needle.kinematics import FloatArray
from labrig.steering.cavities import start_belief
from labrig.steering.policy import SteeringSettings, TipSighting
from labrig.steering.state import SteeringState, take_in_sighting, turn_bevel

# A mean NIS outside of this share of all insertions whose settings fit is an alarm.
_USUAL_SHARE = 0.999
_LEAST_SIGHTINGS = 20
_LEAST_TURNS = 2
# Values that are tried before the best of them is refined, each twice the one before.
_SDS_MM = 0.005 * 2.0 ** np.arange(9)
_BACKLASHES_MM = np.arange(7.0)
_LOG_SD_STEP, _LOG_SD_EXACT = 0.1, 0.05
_BACKLASH_STEP_MM, _BACKLASH_EXACT_MM = 0.1, 0.05

NisVerdict = Literal["too small", "as expected", "too large"]


@dataclass(frozen=True)
class NisJudgement:
    """Mean NIS of the sightings that were believed, the limits of usual values, and the verdict."""

    mean: float
    low: float
    high: float
    verdict: NisVerdict


@dataclass(frozen=True)
class MeasuredMm:
    """A measured length and its standard deviation [mm]."""

    value_mm: float
    sd_mm: float


@dataclass(frozen=True, eq=False)
class SeenInsertion:
    """An insertion as it was seen: the state at its start, then all sightings and turns of the bevel [rad]."""

    start: SteeringState
    way: tuple[TipSighting | float, ...]

    @property
    def sightings(self) -> int:
        """The number of pictures in which the tip was found."""
        return sum(isinstance(part, TipSighting) and part.position_mm is not None for part in self.way)

    @property
    def turns(self) -> int:
        """The number of turns."""
        return sum(isinstance(part, float) for part in self.way)


def judge_nis(nis: Sequence[float], observed: int) -> NisJudgement | None:
    """Return whether the NIS of sightings with this many coordinates is as expected; None for fewer than twenty."""
    if len(nis) < _LEAST_SIGHTINGS:
        return None
    freedom = observed * len(nis)
    low, high = (
        2.0 * float(gammaincinv(freedom / 2, share)) / len(nis)  # quantiles of chi-square
        for share in ((1.0 - _USUAL_SHARE) / 2, (1.0 + _USUAL_SHARE) / 2)
    )
    mean = math.fsum(nis) / len(nis)
    verdict: NisVerdict = "too small" if mean < low else "too large" if mean > high else "as expected"
    return NisJudgement(mean, low, high, verdict)


def measure_sighting_sd(insertions: Sequence[SeenInsertion], settings: SteeringSettings) -> MeasuredMm | None:
    """Return the most likely standard deviation of a sighting along each axis under these settings.

    None for fewer than twenty sightings, or for the paper's filter, which takes the seen position as the tip's and
    predicts nothing.
    """
    sightings = sum(insertion.sightings for insertion in insertions)
    if sightings < _LEAST_SIGHTINGS or settings.estimator.method == "paper":
        return None

    def cost(log_sd: float) -> float:
        estimator = settings.estimator.model_copy(update={"observation_sd_mm": math.exp(log_sd)})
        return _find_cost(insertions, replace(settings, estimator=estimator))

    found = _find_minimum(cost, np.log(_SDS_MM), _LOG_SD_EXACT, _LOG_SD_STEP)
    return None if found is None else MeasuredMm(math.exp(found[0]), math.exp(found[0]) * found[1])


def measure_backlash(insertions: Sequence[SeenInsertion], settings: SteeringSettings) -> MeasuredMm | None:
    """Return the most likely backlash under these settings; None for fewer than two turns or the paper's filter."""
    turns = sum(insertion.turns for insertion in insertions)
    if turns < _LEAST_TURNS or settings.estimator.method == "paper":
        return None

    def cost(backlash_mm: float) -> float:
        policy = settings.policy.model_copy(update={"backlash_mm": max(backlash_mm, 0.0)})
        return _find_cost(insertions, replace(settings, policy=policy))

    found = _find_minimum(cost, _BACKLASHES_MM, _BACKLASH_EXACT_MM, _BACKLASH_STEP_MM)
    return None if found is None else MeasuredMm(*found)


def _find_minimum(
    cost: Callable[[float], float], coarse: FloatArray, exact: float, step: float
) -> tuple[float, float] | None:
    """Return where minus a log-likelihood is least, and the standard deviation by its curvature; None if flat."""
    best = int(np.argmin([cost(value) for value in coarse.tolist()]))
    around = float(coarse[max(best - 1, 0)]), float(coarse[min(best + 1, len(coarse) - 1)])
    at = float(minimize_scalar(cost, bounds=around, method="bounded", options={"xatol": exact}).x)
    curvature = (cost(at + step) - 2.0 * cost(at) + cost(at - step)) / step**2
    return (at, 1.0 / math.sqrt(curvature)) if curvature > 0.0 else None


def _find_cost(insertions: Sequence[SeenInsertion], settings: SteeringSettings) -> float:
    """Return minus the log-likelihood of all sightings."""
    return -math.fsum(_find_log_likelihood(insertion, settings) for insertion in insertions)


def _find_log_likelihood(insertion: SeenInsertion, settings: SteeringSettings) -> float:
    belief = start_belief(insertion.start.tip.pose, settings.estimator)
    state = replace(insertion.start, belief=belief)
    total = 0.0
    for part in insertion.way:
        if isinstance(part, TipSighting):
            state = take_in_sighting(state, part, settings)
            total += 0.0 if part.position_mm is None else state.belief.log_evidence
        else:
            state = turn_bevel(state, part, settings)
    return total
