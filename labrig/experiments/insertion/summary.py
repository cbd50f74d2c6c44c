"""Terminal summary of insertions to a target, and of the commands that other settings would have given."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import zip_longest
from typing import Any

from labrig.analysis.summary import ResultComparison, Summary, TextTable
from labrig.experiments.shared.specimen_result import summarise_maps
from labrig.text import interval, number

_HEADS = (
    "insertion", "outcome", "error mm", "in space mm", "true error mm", "true clearance mm", "length mm", "replans",
)  # fmt: skip
_SOURCE_HEADS = (
    "sources of uncertainty", "roll zero mm", "bevel's lag mm", "wandering mm", "start mm", "in the plane mm",
    "target mm", "seen behind the plane mm",
)  # fmt: skip
_SOURCES = ("roll_zero", "torsion", "heading_noise", "start", "in_plane", "target")
_PLACES = {
    "shaft": "the shaft in the last picture alone",
    "shaft_and_estimate": "the shaft in the last picture and the estimate on the way together",
    "estimate": "the estimate on the way alone",
}
_COMMAND = ("roll_rad", "observe_at_mm", "run_to_mm", "stop")


@dataclass(frozen=True)
class CommandDivergence:
    """The first command that differs: its picture (None: before the first), its depth, and both values."""

    frame: int | None
    depth_mm: float
    what: str
    old: float | str | None
    new: float | str | None


@dataclass(frozen=True)
class SteeringSummary:
    """The commands of an insertion with one set of settings: its turns, its replans, and its first stop.

    `tip_mm` is the estimated tip at the last picture, (y, z); None without a picture.
    """

    turns: int
    replans: int
    stop: str | None
    tip_mm: tuple[float, float] | None
    turns_at_mm: tuple[float, ...]


@dataclass(frozen=True)
class WhatIf:
    """One insertion in two results; `divergence` is None if all commands are equal."""

    trial: int
    old: SteeringSummary
    new: SteeringSummary
    divergence: CommandDivergence | None


def compare_steering(old: Mapping[str, Any], new: Mapping[str, Any]) -> tuple[WhatIf, ...]:
    """Compare the commands in two results of an insertion run, insertion by insertion.

    Parameters
    ----------
    old, new : Mapping
        Their documents. An insertion that is missing in one of them, or whose commands an older labrig did not
        record, is left out; so are results of other experiments.
    """
    before = {trial["trial"]: trial for trial in old.get("insertions", ()) if trial.get("commands")}
    after = {trial["trial"]: trial for trial in new.get("insertions", ()) if trial.get("commands")}
    return tuple(_compare_trials(before[trial], after[trial]) for trial in after if trial in before)


def _compare_trials(old: Mapping[str, Any], new: Mapping[str, Any]) -> WhatIf:
    divergence = _find_divergence(old["commands"], new["commands"])
    return WhatIf(new["trial"], summarise_steering(old), summarise_steering(new), divergence)


def summarise_steering(insertion: Mapping[str, Any]) -> SteeringSummary:
    """Return the summary of an insertion's commands; results of earlier versions have none."""
    commands, steps = insertion["commands"], insertion["steps"]
    turns = tuple(command["depth_mm"] for command in commands if command["roll_rad"] != 0.0)
    last, tip = commands[-1], steps[-1]["estimate_mm"] if steps else None
    return SteeringSummary(len(turns), last["replans"], last["stop"], tip and (tip[0], tip[1]), turns)


def _find_divergence(
    old: Sequence[Mapping[str, Any]], new: Sequence[Mapping[str, Any]]
) -> CommandDivergence | None:
    nothing = dict.fromkeys(_COMMAND)
    for before, after in zip_longest(old, new):
        there = after or before
        for what in _COMMAND:
            old_value, new_value = (before or nothing)[what], (after or nothing)[what]
            if old_value != new_value:
                return CommandDivergence(there["frame"], there["depth_mm"], what, old_value, new_value)
    return None


def summarise(document: Mapping[str, Any]) -> Summary:
    """Return a row for each insertion, what its interval in space consists of, and how many reached the target."""
    trials = document["insertions"]
    rows = tuple(
        (
            trial["trial"] + 1,
            trial["outcome"].replace("_", " "),
            number(trial["target_error_mm"]),
            interval(trial.get("target_error_interval_mm")),
            number(trial["true_target_error_mm"]),
            number(trial["true_min_clearance_mm"]),
            number(trial["length_mm"], 1),
            trial["replans"],
        )
        for trial in trials
    )
    arrived = f"{document['arrived']} of {document['made']} reached the target"
    in_plane = sum(trial["reached"] is None for trial in trials)
    arrived += f", {in_plane} in the plane only" if in_plane else ""
    values: dict[str, object] = {"target reached": f"{document['arrived']} of {document['made']}"}
    for trial in trials:
        values |= _list_values(trial)
    noise = describe_sighting_noise(document.get("sighting_noise"))
    alarm = () if noise is None else (noise,)
    places = describe_places(
        [(trial["trial"], source) for trial in trials if (source := trial.get("target_error_interval_by"))]
    )
    rests_on = () if places is None else (f"error mm: by the shaft in the last picture; in space: {places}",)
    specimens = summarise_maps(document.get("maps", ()))
    tables = (TextTable(_HEADS, rows), *_list_sources(trials))
    return Summary((*tables, *rests_on, arrived, *_list_markers(trials), *alarm, *specimens), values)


def _list_markers(trials: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield what each marker moved in each insertion."""
    for trial in trials:
        for marker in trial.get("markers", ()):
            y_mm, z_mm = marker["displacement_mm"]
            yield (
                f"insertion {trial['trial'] + 1}: marker {marker['marker_id']} moved {marker['moves']} by "
                f"{y_mm:+.2f} mm along y and {z_mm:+.2f} mm along z"
            )


def _list_sources(trials: Sequence[Mapping[str, Any]]) -> Iterator[TextTable]:
    """Yield the table of what the intervals in space consist of; results without intervals have none."""
    rows = tuple(
        (
            f"insertion {trial['trial'] + 1}",
            *(number(sources.get(source, 0.0), 2) for source in _SOURCES),
            _format_depth(trial.get("depth")),
        )
        for trial in trials
        if (sources := trial.get("target_error_sources_mm")) is not None
    )
    if rows:
        yield TextTable(_SOURCE_HEADS, rows)


def describe_places(places: Sequence[tuple[int, str]]) -> str | None:
    """Return by what the ends are known from which the intervals in space are; None without an interval.

    Parameters
    ----------
    places : sequence of (int, str)
        Each trial with an interval, and its `target_error_interval_by`.
    """
    found = dict.fromkeys(source for _, source in places)
    if len(found) < 2:
        return next((f"by {_PLACES[source]}" for source in found), None)
    return "; ".join(
        f"{'insertion' if len(numbers) == 1 else 'insertions'} {', '.join(numbers)} by {_PLACES[source]}"
        for source in found
        if (numbers := [str(trial + 1) for trial, by in places if by == source])
    )


def describe_sighting_noise(noise: Mapping[str, Any] | None) -> str | None:
    """Return what the NIS says against the stated noise, and what to state; None where nothing is to be changed."""
    if noise is None or noise["verdict"] == "as expected":
        return None
    low, high = noise["usual_nis"]
    found = f"mean NIS {noise['mean_nis']:.2g}, usually {low:.1f} to {high:.1f}"
    stated_mm, advised_mm = noise["stated_observation_sd_mm"], noise["advised_observation_sd_mm"]
    if noise["verdict"] == "too small":
        if advised_mm is None or advised_mm >= stated_mm:
            return None
        how = "better"
    elif advised_mm is None or advised_mm <= stated_mm:
        return f"{found}: the needle moves otherwise than radius_mm, backlash_mm and process_sd_deg_per_root_mm say"
    else:
        how = "worse"
    return (
        f"{found}: the tip was seen {how} than estimator.observation_sd_mm {stated_mm:g} says; "
        f"{advised_mm:.2g} would fit"
    )


def _format_depth(depth: Mapping[str, Any] | None) -> str:
    return "-" if depth is None else f"{depth['picture_x_mm']:+.1f} ± {depth['picture_sd_mm']:.1f}"


def _list_values(trial: Mapping[str, Any]) -> dict[str, object]:
    name = f"insertion {trial['trial'] + 1}"
    values = {
        f"{name}: error mm": trial["target_error_mm"],
        f"{name}: error in space mm": interval(trial.get("target_error_interval_mm")),
        f"{name}: error in space by": trial.get("target_error_interval_by"),
        f"{name}: error by the estimate mm": trial["template_error_mm"],
        f"{name}: mean NIS": trial["mean_nis"],
        f"{name}: sightings not believed": trial["missed_sightings"],
    }
    if trial.get("commands"):
        steering = summarise_steering(trial)
        values[f"{name}: turns asked for"] = steering.turns
        values[f"{name}: paths found anew"] = steering.replans
        values[f"{name}: stop"] = steering.stop
    return values


def compare(old: Mapping[str, Any], new: Mapping[str, Any]) -> ResultComparison:
    """Return the first command of each insertion that differs with the new settings."""
    comparisons = compare_steering(old, new)
    lines = [_describe_divergence(what_if) for what_if in comparisons]
    if not new["overrides"] and any(trial.get("as_recorded") is False for trial in new["insertions"]):
        lines.append("this labrig estimates otherwise than the one that made the run, with the same settings")
    return ResultComparison(
        tuple(lines), {"what_if": [asdict(what_if) for what_if in comparisons]} if comparisons else {}
    )


def _describe_divergence(what_if: WhatIf) -> str:
    name, first = f"insertion {what_if.trial + 1}", what_if.divergence
    if first is None:
        return f"{name}: every command is the same"
    where = "before it moves" if first.frame is None else f"at {first.depth_mm:.1f} mm, frame {first.frame}"
    return f"{name}: first command that differs {where}: {first.what} {first.old} before, {first.new} now"
