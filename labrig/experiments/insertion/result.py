"""The result of insertions: how close to their targets they ended, and the estimated tip along the way."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import pandas as pd

from labrig.analysis.result import (
    Point,
    Result,
    Sentinel,
    Summary,
    TextTable,
    TrialOrigin,
    make_origin_table,
    tabulate,
)
from labrig.experiments.insertion.events import SeenMarker, Sighted, TrueObstacle
from labrig.protocol.model import Model
from labrig.steering.problem import Obstacle
from labrig.steering.refusal import RefusalCause
from labrig.steering.sighting_noise import SightingNoise
from labrig.text import interval, number
from labrig.vision.error_budget import ErrorBudget

EndSource = Literal["shaft", "shaft_and_estimate", "estimate"]
"""By what the place of the needle's end is known: the shaft in the final picture, the estimate on the way, or both."""

# A target may be off along each of so many axes, an end out of the plane along one; `in_plane` is over its two already.
_TARGET_AXES = 3

_HEADS = (
    "insertion", "outcome", "error mm", "in space mm", "by", "true error in space mm", "true clearance mm",
    "length mm", "replans",
)  # fmt: skip


class InsertionStep(Sighted, Model):
    """One observation of the needle, estimated again from the recorded picture.

    `clearance_mm` is from the needle's surface at the estimated tip to the nearest obstacle's. `true_mm` and
    `true_heading_rad` are known of simulated worlds alone.
    """

    t_s: float
    clearance_mm: float | None
    true_mm: Point | None
    true_heading_rad: float | None


class TargetErrorSources(Model):
    """Standard deviations of the distance of a needle's end from its target [mm], by source.

    Four lead the end out of the plane: `roll_zero` is by the roll zero, `torsion` by the bevel's lag behind its drive,
    `heading_noise` by the needle's wandering, `start` by place and lean of the start. `in_plane` is by the reading of
    the picture, over both axes, `target` by the place of the target, along each axis.
    """

    roll_zero: float
    torsion: float
    heading_noise: float
    start: float
    in_plane: float
    target: float = 0.0

    @property
    def over_all_axes(self) -> Mapping[str, float]:
        """The standard deviations over all axes together [mm], which can be compared."""
        return self.model_dump() | {"target": math.sqrt(_TARGET_AXES) * self.target}

    @property
    def largest(self) -> str:
        """The source with the largest part of the variance over all axes."""
        sources = self.over_all_axes
        return max(sources, key=lambda source: sources[source])


class MarkerStep(SeenMarker, Model):
    """A marker in a picture, by its recorded corners."""

    frame: int
    depth_mm: float


class EndDepth(Model):
    """How far the end of a needle is out of the plane, positive away from the camera, with standard deviations [mm].

    `x_mm` is by the picture and by what was known before, `picture_x_mm` by the picture alone: by the needle's width
    along its length, and by the length seen. `contradicts`: the two do not agree, and `x_mm` is the picture's.
    """

    x_mm: float
    sd_mm: float
    picture_x_mm: float
    picture_sd_mm: float
    contradicts: bool


class InsertionRow(Model):
    """The members of an insertion that are a number or a word, the columns of the table; see `InsertionTrial`."""

    trial: int
    outcome: str
    stop: str
    cause: str
    reached: bool | None
    tolerance_mm: float
    target_error_mm: float | None
    sigma_target_error_mm: float | None = None
    target_error_budget_mm: ErrorBudget | None = None
    target_error_interval_mm: Point | None = None
    target_error_interval_by: EndSource | None = None
    unmeasured: str | None
    refused: RefusalCause | None = None
    template_error_mm: float | None
    true_target_error_mm: float | None
    true_min_clearance_mm: float | None
    replans: int
    length_mm: float | None
    missed_sightings: int
    mean_nis: float | None


class InsertionTrial(InsertionRow):
    """One insertion: how it ended, and how far from its target by the end of its shaft in the final picture.

    `reached`: it was steered there, and its end lies within the tolerance in space. None: it does in the plane, and one
    camera does not tell for space. `target_error_interval_mm` holds the distance in space with a probability of 95 %,
    and `target_error_sources_mm` says what that consists of; without `out_of_plane:` in the protocol both are None, and
    the plane decides. `target_error_interval_by` and `target_error_interval_tip_mm`, (y, z), say from which place it is
    measured. `depth` is what the final picture shows of it; None if it shows nothing. `picture_interval_mm` is the
    interval by that picture alone, which the needle's stated radius and the estimate have no part in.
    `target_mm` is (x, y, z), `tip_mm` (y, z), with `shaft_mm` the needle's centre line up to there; `unmeasured` says
    why there is no tip. `target_error_mm` is from that tip, by the shaft alone; where the picture shows that the needle
    has left the plane, from its place at the depth that is told. `target_error_budget_mm` says what
    `sigma_target_error_mm` consists of: lens, plane (with the drift between the grid pictures), surface, roll (what the
    depth that is not known makes of the place), lighting, and the reading of the end.
    `template_error_mm` is the same distance by the estimate, which steered: it is there to be
    compared, and is no measurement of the error. `refused` says why the last search found no path. `mean_nis` is over
    the steps that were believed; two degrees of freedom, so 2 where the noise is what the protocol says. `as_recorded`
    says whether every estimate is the one of the live run within a tenth of its standard deviation, as it is with its
    settings.
    `target_mm` and `obstacles` are where they were at the start. `marker_ids` are the markers that the target and each
    obstacle are bound to, the target's first, `marker_steps` what these showed. Errors and clearances are from where
    they were then.
    `true_path_mm`, (x, y, z), `true_target_mm` and `true_obstacles` are where they are in a simulated world.
    """

    start_t_s: float
    target_mm: tuple[float, float, float]
    obstacles: tuple[Obstacle, ...]
    final_frame: int | None
    tip_mm: Point | None
    shaft_mm: tuple[Point, ...]
    target_error_interval_tip_mm: Point | None = None
    picture_interval_mm: Point | None = None
    target_error_sources_mm: TargetErrorSources | None = None
    depth: EndDepth | None = None
    true_path_mm: tuple[tuple[float, float, float], ...]
    true_target_mm: tuple[float, float, float] | None = None
    true_obstacles: tuple[TrueObstacle, ...] = ()
    steps: tuple[InsertionStep, ...]
    as_recorded: bool | None = None
    marker_ids: tuple[int | None, ...] = ()
    marker_steps: tuple[MarkerStep, ...] = ()

    @property
    def markers(self) -> Sequence[tuple[str, MarkerStep]]:
        """What each marker moves, and how it was in the last picture."""
        last = {step.marker_id: step for step in self.marker_steps}
        return [(name_bound(self.marker_ids, marker_id), last[marker_id]) for marker_id in sorted(last)]


def name_bound(marker_ids: Sequence[int | None], marker_id: int) -> str:
    """Return what is bound to a marker: target, obstacle 1, obstacle 2."""
    bound = (place for place, own in enumerate(marker_ids) if own == marker_id)
    return ", ".join(f"obstacle {place}" if place else "target" for place in bound)


class InsertionResult(Result):
    """Of insertion runs: how many of how many arrived; errors and length are the largest, clearance the smallest.

    `causes` counts why the others did not. `reached` is False if one of them missed, None if none missed and one is not
    known to have arrived in space. `sighting_noise` is None for fewer than twenty sightings.
    `not_in_interval` lists the sources of error that an error bar leaves out.
    """

    kind: Literal["insertion"] = "insertion"
    made: int
    arrived: int
    causes: dict[str, int]
    reached: bool | None
    target_error_mm: float | None
    target_error_interval_mm: Point | None = None
    true_target_error_mm: float | None
    true_min_clearance_mm: float | None
    replans: int
    length_mm: float | None
    insertions: tuple[InsertionTrial, ...]
    origins: tuple[TrialOrigin, ...] = ()
    sentinel: Sentinel | None = None
    sighting_noise: SightingNoise | None = None
    not_in_interval: tuple[str, ...] = ()

    @property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """The tables of the result."""
        steps = {f"steps-{trial.trial}": tabulate(InsertionStep, trial.steps) for trial in self.insertions}
        marked = [trial for trial in self.insertions if trial.marker_steps]
        markers = {f"markers-{trial.trial}": tabulate(MarkerStep, trial.marker_steps) for trial in marked}
        insertions = {"insertions": tabulate(InsertionRow, self.insertions)}
        return insertions | make_origin_table(self.origins) | steps | markers


RunResult = InsertionResult


def summarise(document: Mapping[str, Any]) -> Summary:
    """Return a row for each insertion, unless none was measured, and what the page's verdict omits."""
    trials = document["insertions"]
    rows = tuple(
        (
            trial["trial"] + 1,
            trial["outcome"].replace("_", " "),
            number(trial["target_error_mm"]),
            interval(trial.get("target_error_interval_mm")),
            (trial.get("target_error_interval_by") or "-").replace("_", " "),
            number(trial["true_target_error_mm"]),
            number(trial["true_min_clearance_mm"]),
            number(trial["length_mm"], 1),
            trial["replans"],
        )
        for trial in trials
    )
    measured = any(trial["target_error_mm"] is not None for trial in trials)
    noise = describe_nis(document.get("sighting_noise"))
    changed = not document["overrides"] and any(trial["as_recorded"] is False for trial in trials)
    lines = (
        TextTable(_HEADS, rows) if measured else None,
        measured
        and "error mm: by the shaft in the final picture; in space: by that, by the estimate, or by both; "
        "true: from where the target truly was",
        noise,
        changed and "this labrig estimates otherwise than the one that made the run, with the same settings",
    )
    return tuple(line for line in lines if line)


def describe_radius(noise: Mapping[str, Any] | None, settings: Mapping[str, Any]) -> str | None:
    """Return how the needle bent; None where that is not known, or as the settings state it."""
    stated_mm, stated_sd_mm = settings["planner"]["radius_mm"], settings["estimator"]["radius_sd_mm"]
    mm, sd_mm = (noise or {}).get("radius_mm"), (noise or {}).get("radius_sd_mm")
    if mm is None or sd_mm is None or abs(mm - stated_mm) < 3.0 * math.hypot(sd_mm, stated_sd_mm):
        return None
    stated = f"{stated_mm:g} mm (SD {stated_sd_mm:g} mm)" if stated_sd_mm else f"{stated_mm:g} mm"
    return f"By the sightings the bending radius is {mm:.1f} mm (SD {sd_mm:.1f} mm); the protocol states {stated}"


def describe_nis(noise: Mapping[str, Any] | None) -> str | None:
    """Return what the NIS says against the stated noise, and what to state; None where nothing is to be changed."""
    if noise is None or noise["verdict"] == "as expected":
        return None
    (low, high), mean, is_small = noise["usual_nis"], noise["mean_nis"], noise["verdict"] == "too small"
    stated_mm, advised_mm = noise["stated_observation_sd_mm"], noise["advised_observation_sd_mm"] or math.nan
    found = f"The mean NIS is {mean:.2f}, where {low:.2f} to {high:.2f} is usual"
    share = stated_mm / advised_mm
    if is_small and not share > 1.0:
        return None
    if is_small or (share < 1.0 and mean * share**2 <= high):
        how = "better" if is_small else "worse"
        told = f"the tip was seen {how} than the stated {stated_mm:g} mm; {advised_mm:.2g} mm would fit"
    else:
        told = "the needle moves otherwise than stated: its radius, wandering (also out of the plane) or backlash"
        backlash_mm, sd_mm = noise.get("backlash_mm"), noise.get("backlash_sd_mm")
        if backlash_mm and sd_mm and abs(backlash_mm - noise["stated_backlash_mm"]) > 2 * sd_mm:
            told += f", which was measured as {backlash_mm:.1f} ± {sd_mm:.1f} mm, not {noise['stated_backlash_mm']:g}"
    return f"{found}: {told}"
