"""The page of a campaign, its result as a document, and its figures, in the campaign's folder."""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path

import pandas as pd

from labrig.campaign.figures import draw_arms, draw_map, draw_over_points
from labrig.campaign.result import CampaignResult
from labrig.campaign.statistics import ArmResult, PairResult
from labrig.campaign.tasks import LoadedCampaign
from labrig.durable import write_atomically
from labrig.record.json_lines import encode_document
from labrig.report.figures import DrawnFigure, write_figure
from labrig.report.formatting import (
    count_decimals,
    label_quantity,
    name_settings,
    number,
    signed,
    split_quantity,
)
from labrig.report.page import REPORT_FILE, tell_writing
from labrig.report.page import write_page as write_document
from labrig.text import format_count

RESULT_FILE = "result.json"
TEMPLATE = Path(__file__).parent / "page.html.jinja"
_MOST_NAMED = 3
_ENDS = {
    "complete": "All are done.",
    "by_rule": "The rule of the campaign ended it.",
    "incomplete": "{done} of {tasks} are done.",
}


def write_page(
    folder: Path, loaded: LoadedCampaign, result: CampaignResult, table: pd.DataFrame, created: datetime
) -> Path:
    """Write report.html, result.json, and the figures as SVG and PDF; return the page.

    Parameters
    ----------
    table : DataFrame
        One row for each task that is done.

    Raises
    ------
    DiskError
        When one of them cannot be written.
    """
    drawn = () if loaded.file.sample is None else tuple(loaded.file.sample.keys)
    arms, points = draw_arms(result, table), draw_over_points(result, table, drawn) if drawn else None
    circles = loaded.arms[0].protocol.find_map_circles(*drawn) if len(drawn) == 2 else ()
    maps = [*_draw_maps(result, table, drawn, circles)]
    for figure in (arms, points, *(figure for _, figure in maps)):
        if figure is not None:
            write_figure(folder, figure)
    write_atomically(folder / RESULT_FILE, encode_document(result.model_dump(mode="json")))
    shown = {
        "content": result,
        "file": loaded.file,
        "verdict": _summarise(result),
        "measure": label_quantity(result.measure),
        "arms_figure": arms,
        "points_figure": points,
        "maps": maps,
        "circles": circles,
        "commands": [shlex.join(case.command) for case in result.worst],
        "written": tell_writing(created),
    }
    write_document(folder / REPORT_FILE, TEMPLATE, shown, _make_filters(result))
    return folder / REPORT_FILE


def _draw_maps(
    result: CampaignResult,
    table: pd.DataFrame,
    keys: Sequence[str],
    circles: Sequence[tuple[float, float, float]],
) -> Iterator[tuple[str, DrawnFigure]]:
    """Yield the name and a map of each arm, where two keys are sampled and there is a tolerance."""
    for index, arm in enumerate(result.arms, start=1):
        rows = table[(table["arm"] == arm.name) & table["error"].isna()]
        if len(keys) == 2 and result.tolerance is not None and len(rows):
            yield arm.name, draw_map(result, rows, (keys[0], keys[1]), circles, f"map-{index}")


def _summarise(result: CampaignResult) -> Sequence[str]:
    """Return the result in a sentence or two."""
    arms, ended = format_count(len(result.arms), "arm"), _ENDS[result.ended]
    whole = f"{format_count(result.done, 'task')} of {result.experiment} in {arms}."
    failed = f" {format_count(result.failed, 'task')} failed with an error." if result.failed else ""
    return _state_finding(result), f"{whole} {ended.format(done=result.done, tasks=result.tasks)}{failed}"


def _state_finding(result: CampaignResult) -> str:
    """Return in a sentence what the intervals allow to be said, and no more."""
    name, unit = split_quantity(result.measure)
    if not any(arm.n for arm in result.arms):
        return f"No task has a value of the {name}."
    if not result.pairs:
        return _state_mean(result.arms[0], name, unit)
    bounded = [pair for pair in result.pairs if pair.ci95 is not None]
    first = name_settings(result.pairs[0].a)
    if not bounded:
        return f"No difference from {first} has an interval, which takes two pairs of values."
    apart = [pair for pair in bounded if pair.ci95 and not pair.ci95[0] <= 0.0 <= pair.ci95[1]]
    if not apart:
        return f"No arm is known to differ from {first} in the mean {name}: the 95 % intervals hold 0."
    told = "; ".join(_state_difference(pair, unit) for pair in apart[:_MOST_NAMED])
    more = f"; and {len(apart) - _MOST_NAMED} more" if len(apart) > _MOST_NAMED else ""
    differ = "differs" if len(apart) == 1 else "differ"
    count = f"{len(apart)} of {format_count(len(bounded), 'arm')}"
    return f"{count} {differ} from {first} in the mean {name}: {told}{more}."


def _state_difference(pair: PairResult, unit: str | None) -> str:
    """Return by how much an arm is above or below the first, with the 95 % interval."""
    low, high = pair.ci95 or (0.0, 0.0)
    mean = pair.mean or 0.0
    ends = (low, high) if mean >= 0 else (-high, -low)
    where = "above" if mean >= 0 else "below"
    by = f"{number(abs(mean))}{f' {unit}' if unit else ''}"
    return f"{name_settings(pair.b)} is {by} {where} ({number(ends[0])} to {number(ends[1])})"


def _state_mean(arm: ArmResult, name: str, unit: str | None) -> str:
    of = f" {unit}" if unit else ""
    if arm.ci95 is None:
        return f"One task has a value of the {name}: {number(arm.mean)}{of}. That tells no spread."
    low, high = (number(limit) for limit in arm.ci95)
    return f"The mean {name} is {number(arm.mean)}{of} (95 % interval {low} to {high}) over {arm.n} tasks with a value."


def _make_filters(result: CampaignResult) -> Mapping[str, object]:
    """Return filters that write numbers with as many decimals as the narrowest interval of a mean deserves."""
    decimals = count_decimals((arm.ci95 for arm in result.arms), (arm.mean for arm in result.arms), 6)
    return {
        "digits": lambda value: number(value, decimals),
        "plus": lambda value: signed(value, decimals),
        "words": name_settings,
        "percent": lambda value: "–" if value is None else f"{100 * value:.1f}",
        "points": lambda value: "–" if value is None else f"{100 * value:+.1f}",
    }
