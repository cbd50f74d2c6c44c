"""How an insertion ended: decided at its end, and again in the analysis, by the same functions.

The camera shows where the needle's end is in the plane. How far it may be out of the plane follows from the path and
from the standard deviations under `out_of_plane:` in the protocol, and how far the target may be from its place from
`target.sd_mm`. The target is reached if the 95 % interval of the distance in space lies within the tolerance.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrig.errors import Problem
from labrig.experiments.insertion.events import BevelTurn
from labrig.experiments.insertion.result import EndDepth, EndSource, TargetErrorSources
from labrig.protocol.yaml_text import load_yaml_values
from labrig.steering.arrival import TipOffset, bound_target_error, decide_arrival
from labrig.steering.out_of_plane import (
    OutOfPlaneBudget,
    OutOfPlaneSettings,
    budget_out_of_plane,
    covary_out_of_plane,
)
from labrig.steering.policy import SteeringSettings
from labrig.steering.sighting_noise import TEMPLATE_BIAS_MM
from labrig.steering.torsion import RolledStretch
from labrig.vision.depth import Depth, PossibleDepth, measure_depth
from labrig.vision.error_budget import PlaceErrors, budget_place
from labrig.vision.out_of_plane import Perspective
from labrig.vision.plane import PlaneMap
from labrig.vision.shaft_tip import ShaftTip

FloatArray = NDArray[np.float64]
Point = tuple[float, float, float]

# Distance between the points of the needle whose depths are estimated together, and the fewest of them.
_NODE_MM, _LEAST_NODES = 2.0, 12

# For each source of error its name and what makes it smaller.
_SOURCES: Mapping[str, Any] = load_yaml_values(Path(__file__).with_name("error_sources.yaml"))

# While the bend swings over in the last stretch of a shaft, its end is read off by so many needle widths: 0.18 mm (rms)
# in the 37 of 85 runs of protocols/insertion.yaml that ended so, 0.07 mm in the others.
SWINGS_MM, SWUNG = 6.0, 0.17
# Picture and estimate that differ by more of their standard deviations contradict each other.
_AGREES = 3.0

UNSURE_STOPS = ("needle_lost", "needle_stuck", "sheath_astray", "marker_lost", "marker_jumped")
"""Stops after which a person looks before the needle is withdrawn."""

_LEFT_HINT = (
    "the needle strayed more than out_of_plane: states; look whether needle or sheath leans or is bent"
)


@dataclass(frozen=True)
class Ending:
    """How an insertion ended.

    Attributes
    ----------
    outcome : str
        `reached`, `reached_in_plane_only`, `missed`, `stopped`, or `unknown` if the camera was bumped.
    stop : str
        The reason by its name.
    cause : str
        The reason in words.
    hint : str
        What would help, if that is known.
    """

    outcome: str
    stop: str
    cause: str
    hint: str = ""

    @property
    def reached(self) -> bool | None:
        """Whether the target was reached; None if it was in the plane, and nothing says whether it was in space."""
        return None if self.outcome == "reached_in_plane_only" else self.outcome == "reached"

    @property
    def reason(self) -> str:
        """The reason of a run that ends so: its stop if the needle did, otherwise what became of the target."""
        if self.outcome == "stopped":
            return self.stop
        return "target_missed" if self.outcome == "missed" else self.outcome


def trace_path(
    turns: Sequence[BevelTurn],
    roll_zero_rad: float,
    depth_mm: float,
    centred: int = 0,
    backlash_mm: float = 0.0,
) -> tuple[RolledStretch, ...]:
    """Return the stretches of a path between recorded turns of the bevel; a turn acts half the backlash later.

    `centred` is the direction in which the bevel was turned to the roll zero; 0 if it is not known.
    """
    acting_mm = [min(turn.depth_mm + backlash_mm / 2, depth_mm) for turn in turns]
    lengths_mm = (end - start for start, end in pairwise((0.0, *acting_mm, depth_mm)))
    turned = ((turn.to_rad - roll_zero_rad, int(np.sign(turn.to_rad - turn.from_rad))) for turn in turns)
    rolls = ((0.0, centred), *turned)
    return tuple(RolledStretch(max(0.0, mm), *roll) for mm, roll in zip(lengths_mm, rolls, strict=True))


@dataclass(frozen=True, eq=False)
class EstimatedEnd:
    """The needle's end (y, z) as it was followed on the way, and its standard deviation along each axis [mm]."""

    place_mm: FloatArray
    sd_mm: float
    seen: Sequence[Point] = ()

    @property
    def variance(self) -> float:
        """With what reading a template adds, the same in every picture."""
        return self.sd_mm**2 + TEMPLATE_BIAS_MM**2


@dataclass(frozen=True, eq=False)
class SeenEnd:
    """The needle's end as it is seen, (y, z), with its standard deviation along each axis [mm].

    Parameters
    ----------
    place_mm, sd_mm : ndarray (2,)
        By all that is known of it.
    slope : ndarray (2,)
        By how much the true place moves for each millimetre that the end is out of the plane.
    by : str
        By what the place is known.
    depth : Depth or None
        How far it is out of the plane; None if the picture does not tell.
    shown_mm : ndarray (2,) or None
        As the last picture alone shows it; None if it does not, or if nothing else is known of it.
    """

    place_mm: FloatArray
    sd_mm: FloatArray
    slope: FloatArray
    by: EndSource
    depth: Depth | None = None
    shown_mm: FloatArray | None = None


def see_end(
    plane: PlaneMap,
    shaft: ShaftTip | None,
    estimate: EstimatedEnd | None,
    *,
    drift: float = 0.0,
    depth: Depth | None = None,
) -> SeenEnd | None:
    """Return the end of a measured shaft, and of the estimate if the two agree; without a shaft, of the estimate.

    The roll's part of the error budget is left out: it is what the slope stands for.

    Parameters
    ----------
    plane : PlaneMap
    shaft, estimate
        As in `judge_end`; None for both: nothing tells the end.
    drift : float
        Relative change of scale since the calibration.
    depth : Depth or None
        As the picture shows it.
    """
    by: EndSource = "estimate"
    if shaft is not None:
        by, shown_mm, px, errors = "shaft", np.array(shaft.tip_mm), np.array(shaft.tip_px), shaft.errors
    elif estimate is not None:
        shown_mm, errors = estimate.place_mm, PlaceErrors(fit_mm=math.sqrt(estimate.variance))
        px = plane.to_px(shown_mm[None])[0]
    else:
        return None
    drift_mm = drift * float(np.linalg.norm(shown_mm))
    budgets = [budget_place(plane, px, errors, axis).with_drift(drift_mm) for axis in np.eye(2)]
    read = np.array([(b.fit or 0.0) ** 2 + (b.lighting or 0.0) ** 2 for b in budgets])
    place_mm, shared = shown_mm, np.square([b.calibration for b in budgets])
    if shaft is not None and estimate is not None:
        apart_mm, both = shown_mm - estimate.place_mm, read + estimate.variance
        if np.all(np.abs(apart_mm) <= _AGREES * np.sqrt(both)):
            share = estimate.variance / both
            by, place_mm, read = "shaft_and_estimate", estimate.place_mm + share * apart_mm, share * read
    perspective = Perspective.of(plane)
    slope = np.zeros(2) if perspective is None else perspective.find_slope(place_mm)
    return SeenEnd(place_mm, np.sqrt(shared + read), slope, by, depth, None if shaft is None else shown_mm)


@dataclass(frozen=True, eq=False)
class TargetErrorBounds:
    """The distance between a needle's end and its target.

    Attributes
    ----------
    off_mm : ndarray (2,)
        In the plane, (y, z): of the shaft in the last picture, or, where that is not measured, of the estimate. Where
        the picture contradicts the path it lies on the line of sight at the depth that the picture tells.
    ray_sd_mm : ndarray (2,)
        What its depth, as far as that is not known, makes of it: a standard deviation along each axis.
    interval_mm : (float, float)
        In space, with a probability of 95 %.
    by, tip_mm : str, (float, float)
        From which place (y, z) the interval is, and by what that is known.
    sources : TargetErrorSources
        What is known of it before the picture is asked for the depth.
    depth : EndDepth or None
        How far the end is out of the plane, if the picture tells.
    errors : PlaceErrors
        Of the shaft's end, as far as it is measured.
    picture_interval_mm : (float, float) or None
        The interval by the last picture alone, without the estimate and without what the path tells of the depth.
    """

    off_mm: FloatArray
    ray_sd_mm: FloatArray
    interval_mm: tuple[float, float]
    by: EndSource
    tip_mm: tuple[float, float]
    sources: TargetErrorSources
    depth: EndDepth | None = None
    errors: PlaceErrors = field(default_factory=PlaceErrors)
    picture_interval_mm: tuple[float, float] | None = None

    @property
    def in_plane_mm(self) -> float:
        """The distance in the plane."""
        return float(np.linalg.norm(self.off_mm))

    def decide(self, tolerance_mm: float) -> Ending:
        """Return how an insertion ended that was steered to its target."""
        is_missed, (low_mm, high_mm) = self.in_plane_mm > tolerance_mm, self.interval_mm
        arrival = "missed" if is_missed else decide_arrival(self.interval_mm, tolerance_mm)
        left = self.depth if self.depth is not None and self.depth.contradicts else None
        end = "steered to the target; the needle's end is"
        if left is not None:
            end = (
                f"seen at the target, the needle's end lies {abs(left.x_mm):.1f} mm (SD {left.sd_mm:.1f} mm) "
                f"{'behind' if left.x_mm > 0 else 'before'} the plane, by its width and length in the picture; it is"
            )
        cause = (
            f"{end} {self.in_plane_mm:.2f} mm from the target in the plane, and between {low_mm:.2f} and "
            f"{high_mm:.2f} mm in space (95 %), and {tolerance_mm:g} mm are allowed"
        )
        if left is not None:
            outcome = "missed" if arrival == "missed" else "reached_in_plane_only"
            return Ending(outcome, "left_the_plane", cause, _LEFT_HINT)
        if arrival != "reached_in_plane_only":
            return Ending(arrival, f"target_{arrival}", cause)
        name, hint = _SOURCES[self.sources.largest]
        unseen = f"nothing in the picture shows the depth, and most of the uncertainty comes from {name}"
        if self.depth is not None:
            unseen = f"the picture shows the depth only to {self.depth.picture_sd_mm:.1f} mm (SD)"
        return Ending(arrival, arrival, f"{cause}; {unseen}", hint)

    def warn(self, tolerance_mm: float) -> Problem | None:
        """Return the warning that an end at the target could not be certified; None if it could."""
        low_mm, high_mm = self.interval_mm
        if high_mm <= tolerance_mm:
            return None
        parts = ", ".join(
            f"{sd_mm:.2f} by {_SOURCES[source][0]}"
            for source, sd_mm in self.sources.over_all_axes.items()
            if round(sd_mm, 2)
        )
        return Problem(
            "target.tolerance_mm",
            f"{tolerance_mm:g} mm is below what one camera can certify here: a needle that ends at the target as seen "
            f"in the plane is between {low_mm:.2f} and {high_mm:.2f} mm from it in space (95 %). Standard deviations "
            f"over all axes, in mm: {parts}. Unless the final picture shows the needle's depth, the run ends as "
            "reached_in_plane_only",
            _SOURCES[self.sources.largest][1],
        )

    def describe(self) -> dict[str, Any]:
        """Return the members of an insertion's result."""
        return {
            "target_error_interval_mm": self.interval_mm,
            "target_error_interval_by": self.by,
            "target_error_interval_tip_mm": self.tip_mm,
            "picture_interval_mm": self.picture_interval_mm,
            "target_error_sources_mm": self.sources,
            "depth": self.depth,
        }


def decide_ending(
    stop: str, detail: str, bounds: TargetErrorBounds | None, tolerance_mm: float, doubt: Ending | None = None
) -> Ending:
    """Return how an insertion ended, by the last picture if it was steered to the target.

    Parameters
    ----------
    stop, detail : str
        Of the last command.
    bounds : TargetErrorBounds or None
        By the last picture; None if it was not steered there.
    tolerance_mm : float
        How far from the target the needle may end.
    doubt : Ending or None
        Why the last picture does not tell where target and needle are; None if it does.
    """
    if stop == "target_reached" and doubt is not None:
        return doubt
    if stop == "target_reached" and bounds is not None:
        return bounds.decide(tolerance_mm)
    return Ending("stopped" if stop in UNSURE_STOPS else "missed", stop, detail)


def judge_end(
    path: Sequence[RolledStretch],
    settings: SteeringSettings,
    unseen: OutOfPlaneSettings,
    plane: PlaneMap,
    target_sd_mm: float,
    *,
    shaft: ShaftTip | None = None,
    estimate: EstimatedEnd | None = None,
    drift: float = 0.0,
) -> TargetErrorBounds | None:
    """Return the distance in space from the target to a needle's end; None where nothing tells the end.

    Parameters
    ----------
    path : sequence of RolledStretch
        The path that it has taken, or will take.
    settings : SteeringSettings
        With the target where it is in the end.
    unseen : OutOfPlaneSettings
        What leads it out of the plane.
    plane : PlaneMap
    target_sd_mm : float
        Of the target's place along each axis.
    shaft : ShaftTip or None
        As measured in the last picture.
    estimate : EstimatedEnd or None
        As the end was followed on the way.
    drift : float
        Relative change of scale since the calibration.
    """
    problem = settings.problem
    way_mm = np.array(() if estimate is None else estimate.seen).reshape(-1, 3)
    depth = (
        None if shaft is None else _find_depth(shaft, plane, path, problem.radius_mm, unseen, way_mm=way_mm)
    )
    swings = len(path) > 1 and path[-1].length_mm + settings.policy.backlash_mm / 2 < SWINGS_MM
    if shaft is not None and swings:
        fit_mm = math.hypot(shaft.errors.fit_mm or 0.0, SWUNG * shaft.width_px * plane.mm_per_px)
        shaft = replace(shaft, errors=replace(shaft.errors, fit_mm=fit_mm))
    budget = budget_out_of_plane(path, problem.radius_mm, unseen)

    def bound(estimate: EstimatedEnd | None, depth: Depth | None) -> TargetErrorBounds | None:
        seen = see_end(plane, shaft, estimate, drift=drift, depth=depth)
        return None if seen is None else bound_error(seen, budget, problem.target_mm, target_sd_mm)

    bounds, alone = bound(estimate, depth), None
    if bounds is None or shaft is None:
        return bounds
    if depth is not None:
        by_picture = PossibleDepth(1.0, depth.picture_x_mm, depth.picture_sd_mm)
        alone = bound(None, replace(depth, possible=(by_picture,)))
    return replace(bounds, errors=shaft.errors, picture_interval_mm=alone.interval_mm if alone else None)


def _find_depth(
    shaft: ShaftTip,
    plane: PlaneMap,
    path: Sequence[RolledStretch],
    radius_mm: float,
    unseen: OutOfPlaneSettings,
    *,
    way_mm: FloatArray,
) -> Depth | None:
    """Return how far the needle's end is out of the plane, by the last picture and its path; None if it is not told."""
    perspective = Perspective.of(plane)
    if perspective is None:
        return None
    depth_mm = sum(stretch.length_mm for stretch in path)
    at_mm = np.linspace(0.0, depth_mm, max(_LEAST_NODES, round(depth_mm / _NODE_MM)))
    covariance = covary_out_of_plane(path, radius_mm, unseen, at_mm)
    return measure_depth(shaft, perspective, depth_mm, at_mm, covariance, way_mm=way_mm)


def bound_error(
    seen: SeenEnd, unseen: OutOfPlaneBudget, target_mm: Point, target_sd_mm: float
) -> TargetErrorBounds:
    """Return the distance in space from the target to a needle's end that may be so far out of the plane."""
    depth, x_mm, x_sd_mm = seen.depth, 0.0, unseen.total_mm
    if depth is not None:
        x_mm = depth.x_mm if depth.contradicts else 0.0
        x_sd_mm = math.hypot(depth.sd_mm, depth.x_mm - x_mm)
    off_mm = seen.place_mm - target_mm[1:]
    shown_mm = seen.place_mm if seen.shown_mm is None else seen.shown_mm
    possible = (PossibleDepth(1.0, 0.0, x_sd_mm),) if depth is None else depth.possible
    ray = np.array((1.0, *seen.slope))
    covariance = np.diag((0.0, *np.square(seen.sd_mm))) + target_sd_mm**2 * np.eye(3)
    offsets = (
        TipOffset(
            np.array((-target_mm[0], *off_mm)) + one.x_mm * ray,
            covariance + one.sd_mm**2 * np.outer(ray, ray),
            one.probability,
            seen.slope,
        )
        for one in possible
    )
    return TargetErrorBounds(
        off_mm=shown_mm + x_mm * seen.slope - target_mm[1:],
        ray_sd_mm=x_sd_mm * seen.slope,
        interval_mm=bound_target_error(*offsets),
        by=seen.by,
        tip_mm=(float(seen.place_mm[0]), float(seen.place_mm[1])),
        sources=TargetErrorSources(
            **vars(unseen), in_plane=float(np.linalg.norm(seen.sd_mm)), target=target_sd_mm
        ),
        depth=None if depth is None else EndDepth.model_validate(depth, from_attributes=True),
    )
