"""Terminal summary of insertions to a target."""

from collections.abc import Mapping
from typing import Any

from labrig.analysis.result import Summary, TextTable
from labrig.text import interval, number

_HEADS = (
    "insertion", "outcome", "error mm", "in space mm", "by", "true error mm", "true clearance mm", "length mm",
    "replans",
)  # fmt: skip


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
    noise = describe_sighting_noise(document.get("sighting_noise"))
    changed = not document["overrides"] and any(trial["as_recorded"] is False for trial in trials)
    lines = (
        "error mm: by the shaft in the last picture; in space: by that, by the estimate on the way, or by both",
        f"{arrived}, {in_plane} in the plane only" if in_plane else arrived,
        noise,
        "this labrig estimates otherwise than the one that made the run, with the same settings"
        if changed
        else None,
    )
    return TextTable(_HEADS, rows), *filter(None, lines)


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
