"""How precisely the tip was seen, and the play of the hinges, from the sightings of an insertion themselves.

The estimator predicts each sighting from those before it. The measured values are those under which all sightings of
the insertion were the most probable (maximum likelihood by prediction errors, Schweppe 1965). So they hold whatever
the estimator does not model: a template that reads a bent tip off its place shows as noise of the sightings. The
backlash is measured with a radius that is not known, and the radius with the backlash that was measured.

The mean NIS tells whether the stated settings fit: in the plane it is 2 where they do, smaller where the tip is seen
better than they say, and larger where it is seen worse or moves otherwise (Bar-Shalom, Li and Kirubarajan 2001, section
5.4).
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Self

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import gammaincinv

from labrig.needle.kinematics import FloatArray
from labrig.steering.cavities import TipBelief, start_belief
from labrig.steering.policy import SteeringSettings, TipSighting
from labrig.steering.state import SteeringState, take_in_sighting, turn_bevel
from labrig.steering.tip import CURVATURE, EstimatorSettings

# A mean NIS outside of this share of all insertions whose settings fit is an alarm.
_USUAL_SHARE = 0.999
_LEAST_SIGHTINGS = 20
_LEAST_TURNS = 2
# Values that are tried before the best of them is refined, each twice the one before.
_SDS_MM = 0.005 * 2.0 ** np.arange(9)
_BACKLASHES_MM = np.arange(7.0)
_LOG_SD_STEP, _LOG_SD_EXACT = 0.1, 0.05
_BACKLASH_STEP_MM, _BACKLASH_EXACT_MM = 0.1, 0.05

# Along each axis a template reads a tip off its place that is bent to the other side; no scatter of sightings shows it.
TEMPLATE_BIAS_MM = 0.05
# The template shows so much of the tip. While the bend swings over inside it, the tip is read off its place.
_TEMPLATE_MM = 4.0

Measured = tuple[float, float]
"""A measured length and its standard deviation [mm]."""


@dataclass(frozen=True)
class SightingNoise:
    """What the protocol states about sightings and hinges, and what the sightings themselves say.

    `mean_nis` is over the sightings that were believed in all insertions; where the settings fit it is within
    `usual_nis` in 99.9 % of all runs. Measured values are None where too few sightings, or turns, tell them.
    `advised_observation_sd_mm` is the measured one, and at least what a template reads a tip off that is bent to the
    other side: with less, that counts as motion. `radius_mm` is that of the needle, whatever the protocol states.
    """

    mean_nis: float
    usual_nis: tuple[float, float]
    verdict: Literal["too small", "as expected", "too large"]
    stated_observation_sd_mm: float
    observation_sd_mm: float | None
    observation_sd_sd_mm: float | None
    advised_observation_sd_mm: float | None
    stated_backlash_mm: float
    backlash_mm: float | None
    backlash_sd_mm: float | None
    radius_mm: float | None = None
    radius_sd_mm: float | None = None


@dataclass(frozen=True, eq=False)
class SeenInsertion:
    """An insertion as it was seen: the state at its start, then all sightings and turns of the bevel [rad]."""

    start: SteeringState
    way: tuple[TipSighting | float, ...]

    @property
    def sightings(self) -> int:
        """The number of pictures in which the tip was found."""
        return sum(isinstance(part, TipSighting) and part.position_mm is not None for part in self.way)

    def leave_out_swings(self) -> Self:
        """Return it without the sightings in which the bend swings over inside the template."""
        way, at_mm, swung_mm = list[TipSighting | float](), 0.0, 0.0
        for part in self.way:
            if isinstance(part, float):
                swung_mm = at_mm + _TEMPLATE_MM
                way.append(part)
            else:
                at_mm = part.insertion_mm
                way.append(TipSighting(at_mm, part.position_mm if at_mm >= swung_mm else None))
        return replace(self, way=tuple(way))


def measure_noise(
    insertions: Sequence[SeenInsertion], nis: Sequence[float], stated: SteeringSettings
) -> SightingNoise | None:
    """Return whether the stated noise of the sightings fits, and what it is; None for too few sightings.

    Parameters
    ----------
    insertions : sequence of SeenInsertion
        From which noise and backlash are measured.
    nis : sequence of float
        Of the sightings, of two coordinates each, that were believed in all insertions.
    stated : SteeringSettings
    """
    if len(nis) < _LEAST_SIGHTINGS:
        return None
    low, high = (
        2.0 * float(gammaincinv(len(nis), share)) / len(nis)  # quantiles of chi-square
        for share in ((1.0 - _USUAL_SHARE) / 2, (1.0 + _USUAL_SHARE) / 2)
    )
    mean = math.fsum(nis) / len(nis)
    sd_mm, sd_sd_mm = measure_sighting_sd(insertions, stated) or (None, None)
    advised_mm = None if sd_mm is None else max(sd_mm, TEMPLATE_BIAS_MM)
    fitting = with_observation_sd(stated, advised_mm or TEMPLATE_BIAS_MM)
    steady = [insertion.leave_out_swings() for insertion in insertions]
    backlash_mm, backlash_sd_mm = measure_backlash(steady, fitting) or (None, None)
    measured = stated if backlash_mm is None else _with_backlash(stated, backlash_mm)
    radius_mm, radius_sd_mm = measure_radius(insertions, measured) or (None, None)
    return SightingNoise(
        mean_nis=mean,
        usual_nis=(low, high),
        verdict="too small" if mean < low else "too large" if mean > high else "as expected",
        stated_observation_sd_mm=stated.estimator.observation_sd_mm,
        observation_sd_mm=sd_mm,
        observation_sd_sd_mm=sd_sd_mm,
        advised_observation_sd_mm=advised_mm,
        stated_backlash_mm=stated.policy.backlash_mm,
        backlash_mm=backlash_mm,
        backlash_sd_mm=backlash_sd_mm,
        radius_mm=radius_mm,
        radius_sd_mm=radius_sd_mm,
    )


def with_observation_sd(settings: SteeringSettings, observation_sd_mm: float) -> SteeringSettings:
    """Return the settings with another standard deviation of a sighting."""
    estimator = settings.estimator.model_copy(update={"observation_sd_mm": observation_sd_mm})
    return replace(settings, estimator=estimator)


def _with_backlash(settings: SteeringSettings, backlash_mm: float) -> SteeringSettings:
    return replace(settings, policy=settings.policy.model_copy(update={"backlash_mm": max(backlash_mm, 0.0)}))


def _begin_at(settings: SteeringSettings, radius_sd_mm: float, **begun: Any) -> SteeringSettings:
    """Return settings under which the radius is so uncertain at first."""
    begun = settings.estimator.model_dump() | begun | {"radius_sd_mm": radius_sd_mm}
    return replace(settings, estimator=EstimatorSettings(**begun))


def measure_sighting_sd(insertions: Sequence[SeenInsertion], settings: SteeringSettings) -> Measured | None:
    """Return the most likely standard deviation of a sighting along each axis under these settings.

    None for fewer than twenty sightings, or for the paper's filter, which takes the seen position as the tip's and
    predicts nothing.
    """
    sightings = sum(insertion.sightings for insertion in insertions)
    if sightings < _LEAST_SIGHTINGS or settings.estimator.method == "paper":
        return None

    def cost(log_sd: float) -> float:
        return _find_cost(insertions, with_observation_sd(settings, math.exp(log_sd)))

    found = _find_minimum(cost, np.log(_SDS_MM), _LOG_SD_EXACT, _LOG_SD_STEP)
    # So many sightings tell it no better, however sharp the likelihood where one falls out of the gate.
    least = 0.5 / math.sqrt(sightings)
    return None if found is None else (math.exp(found[0]), math.exp(found[0]) * max(found[1], least))


def measure_backlash(insertions: Sequence[SeenInsertion], settings: SteeringSettings) -> Measured | None:
    """Return the most likely backlash under these settings; None for fewer than two turns or the paper's filter."""
    turns = sum(isinstance(part, float) for insertion in insertions for part in insertion.way)
    if turns < _LEAST_TURNS or settings.estimator.method == "paper":
        return None
    wide = _begin_at(settings, settings.estimator.radius_mm)  # a wrong radius would shift the backlash

    def cost(backlash_mm: float) -> float:
        return _find_cost(insertions, _with_backlash(wide, backlash_mm))

    return _find_minimum(cost, _BACKLASHES_MM, _BACKLASH_EXACT_MM, _BACKLASH_STEP_MM)


def measure_radius(insertions: Sequence[SeenInsertion], stated: SteeringSettings) -> Measured | None:
    """Return the needle's radius; None for a needle that may be straight.

    It is by the default filter, which begins with the stated radius, as uncertain as it is long.
    """
    radius_mm, sd_mm, measured = stated.estimator.radius_mm, stated.estimator.radius_mm, None
    for insertion in (one for one in insertions if one.sightings):
        begun = _begin_at(stated, sd_mm, method="error-state", radius_mm=radius_mm)
        tip = [*_follow(insertion, begun)][-1].tip
        sd = math.sqrt(tip.covariance[CURVATURE, CURVATURE])
        if tip.curvature < 3.0 * sd:
            return None
        measured = radius_mm, sd_mm = 1.0 / tip.curvature, sd / tip.curvature**2
    return measured


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
    return -math.fsum(belief.log_evidence for one in insertions for belief in _follow(one, settings))


def _follow(insertion: SeenInsertion, settings: SteeringSettings) -> Iterator[TipBelief]:
    """Yield what is believed of the tip after each picture."""
    state = replace(insertion.start, belief=start_belief(insertion.start.tip.pose, settings.estimator))
    for part in insertion.way:
        if isinstance(part, float):
            state = turn_bevel(state, part, settings)
        else:
            state = take_in_sighting(state, part, settings)
            yield state.belief
