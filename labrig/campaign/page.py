"""The page of a campaign, its result as a document, and its figures, in the campaign's folder."""

import math
import re
import shlex
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.special import ndtri

from labrig.campaign.figures import draw_arms, draw_map, draw_over_points
from labrig.campaign.result import CampaignResult
from labrig.campaign.statistics import count_ends, read_values
from labrig.campaign.tasks import LoadedCampaign
from labrig.durable import write_atomically
from labrig.record.json_lines import encode_document
from labrig.report.figures import DrawnFigure, write_figure
from labrig.report.formatting import count_decimals, label_key, name_settings, number, signed
from labrig.report.page import REPORT_FILE, tell_writing
from labrig.report.page import write_page as write_document
from labrig.text import split_key, split_quantity, tell_value

RESULT_FILE = "result.json"
_NUMBER = re.compile(r"(\d+\.\d+|\d+(?= mm))")  # not that of an obstacle
TEMPLATE = Path(__file__).parent / "page.html.jinja"


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
    circles = loaded.arms[0].protocol.find_map_circles(*drawn) if len(drawn) == 2 else ()
    maps = [*_draw_maps(result, table, drawn, circles)]
    write_atomically(folder / RESULT_FILE, encode_document(result.model_dump(mode="json")))
    bounded = {pair: pair.ci95 for pair in result.pairs if pair.ci95 is not None}
    # What none of them exceeds by chance, with a probability of 95 %.
    ranks, n = result.rank_correlations, sum(arm.n for arm in result.arms)
    chance = float(ndtri(1.0 - 0.025 / max(1, len(ranks)))) / math.sqrt(max(1, n - 1))
    clear = [key for key, rank in ranks.items() if abs(rank) > chance]
    # The keys that the page speaks of are its first figure, unless that is a map or the arms.
    ordered = sorted(drawn, key=lambda key: -abs(ranks.get(key, 0.0)))
    first = 0 if maps or result.pairs else min(max(1, len(clear)), 3)
    front = draw_over_points(result, table, ordered[:first], "over-first")
    points = draw_over_points(result, table, ordered[first:], "over-points")
    for figure in (arms := draw_arms(result, table), front, points, *(figure for _, figure in maps)):
        if figure is not None:
            write_figure(folder, figure)
    shown = {
        "content": result,
        "file": loaded.file,
        "measure": label_key(result.measure),
        "quantity": split_quantity(result.measure),
        "chance": chance,
        "whys": merge_ends({failure.error: failure.tasks for failure in result.failures}),
        "clear": clear,
        "made": loaded.describe(),
        "bounded": bounded,
        "apart": [pair for pair, (low, high) in bounded.items() if not low <= 0.0 <= high],
        "without": count_ends(table[table["error"].isna() & np.isnan(read_values(table, result.measure))]),
        "arms_figure": arms,
        "front_figure": front,
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


def merge_ends(ends: Mapping[str, int]) -> list[tuple[str, int]]:
    """Return ends, the most frequent first; those that differ in numbers alone are one: `0.50 to 0.69 mm short`."""
    alike = defaultdict[tuple[str, ...], list[list[str]]](list)
    for end, count in ends.items():
        parts = _NUMBER.split(end)
        alike[tuple(parts[::2])] += [parts] * count
    return Counter(
        {"".join(map(_span, zip(*found, strict=True))): len(found) for found in alike.values()}
    ).most_common()


def _span(parts: Sequence[str]) -> str:
    """Return words that are the same in all ends, or the range of a number that is not."""
    return parts[0] if len(set(parts)) == 1 else f"{min(parts, key=float)} to {max(parts, key=float)}"


def _make_filters(result: CampaignResult) -> Mapping[str, object]:
    """Return filters that write numbers with as many decimals as the narrowest interval of a mean deserves."""
    decimals = max(2, count_decimals((arm.ci95 for arm in result.arms), (arm.mean for arm in result.arms), 6))
    return {
        "digits": lambda value: number(value, decimals),
        "plus": lambda value: signed(value, decimals),
        "with_unit": lambda value: tell_value(value, result.measure),
        "words": name_settings,
        "in_words": lambda key: split_key(key)[0],
        "with_key_unit": tell_value,
        "merged": merge_ends,
        "percent": lambda value: "–" if value is None else f"{100 * value:.1f}",
        "points": lambda value: "–" if value is None else signed(100 * value, 1),
    }
