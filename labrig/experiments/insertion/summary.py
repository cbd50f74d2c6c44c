"""Terminal summary of insertions to a target."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from labrig.analysis.result import Summary, TextTable
from labrig.text import interval, number

_HEADS = (
    "insertion", "outcome", "error mm", "in space mm", "by", "true error mm", "true clearance mm", "length mm",
    "replans",
)  # fmt: skip
_SOURCE_HEADS = (
    "sources of uncertainty", "roll zero mm", "bevel's lag mm", "wandering mm", "start mm", "in the plane mm",
    "target mm", "seen behind the plane mm",
)  # fmt: skip
_SOURCES = ("roll_zero", "torsion", "heading_noise", "start", "in_plane", "target")


def summarise(document: Mapping[str, Any]) -> Summary:
    """Return a row for each insertion, what its interval in space consists of, and how many reached the target."""
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
    arrived = f"{document['arrived']} of {document['made']} reached the target"
    in_plane = sum(trial["reached"] is None for trial in trials)
    arrived += f", {in_plane} in the plane only" if in_plane else ""
    values: dict[str, object] = {"target reached": f"{document['arrived']} of {document['made']}"}
    for trial in trials:
        values |= _list_values(trial)
    noise = describe_sighting_noise(document.get("sighting_noise"))
    alarms: tuple[str, ...] = () if noise is None else (noise,)
    if not document["overrides"] and any(trial["as_recorded"] is False for trial in trials):
        alarms += ("this labrig estimates otherwise than the one that made the run, with the same settings",)
    rests_on = (
        (
            "error mm: by the shaft in the last picture; in space: by that, by the estimate on the way, or by both",
        )
        if any(trial.get("target_error_interval_by") for trial in trials)
        else ()
    )
    tables = (TextTable(_HEADS, rows), *_list_sources(trials))
    return Summary((*tables, *rests_on, arrived, *alarms), values)


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
    return {
        f"{name}: error mm": trial["target_error_mm"],
        f"{name}: error in space mm": interval(trial.get("target_error_interval_mm")),
        f"{name}: error in space by": trial.get("target_error_interval_by"),
        f"{name}: error by the estimate mm": trial["template_error_mm"],
        f"{name}: mean NIS": trial["mean_nis"],
        f"{name}: sightings not believed": trial["missed_sightings"],
        f"{name}: paths found anew": trial["replans"],
        f"{name}: stop": trial["stop"],
    }
