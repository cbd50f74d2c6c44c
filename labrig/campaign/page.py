"""The page of a campaign, its result as a document, and its figures, in the campaign's folder."""

import math
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import ndtri

from labrig.campaign.figures import draw_arms, draw_map, draw_over_points
from labrig.campaign.result import CampaignResult
from labrig.campaign.statistics import bound_share, find_failing, find_missed, read_values
from labrig.campaign.tasks import LoadedCampaign
from labrig.durable import write_atomically
from labrig.record.difference import find_differences
from labrig.record.json_lines import encode_document, flatten
from labrig.record.provenance import collect_provenance
from labrig.report.figures import write_figure
from labrig.report.formatting import count_decimals, name_settings
from labrig.report.page import REPORT_FILE, tell_writing
from labrig.report.page import write_page as write_document
from labrig.runner.sight import load_plane_map
from labrig.runner.virtual_sight import ShaftErrors, SightingErrors
from labrig.steering.parameters import SECTIONS
from labrig.text import split_quantity, tell_value

RESULT_FILE = "result.json"
Circle = tuple[float, float, float]
"""Centre and radius of an obstacle, in the units of a map's axes."""
_GRANTED = pd.read_csv(Path(__file__).with_name("granted.csv"), keep_default_na=False).to_numpy().tolist()
"""Key of a simulated world, key of the protocol that says what an insertion reckons with, and why it matters."""
_LENS = "rig.world.lens.distance_mm"


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
    ranges = loaded.file.ranges
    circles = loaded.arms[0].protocol.find_map_circles(*ranges) if len(ranges) == 2 else ()
    known = table[table["error"].isna()].set_index("task")
    known = known.assign(value=read_values(known, result.measure), missed=find_missed(known))
    maps = [
        (arm.name, draw_map(result, rows, ranges, circles, f"map-{place}"))
        for place, arm in enumerate(result.arms, start=1)
        if len(ranges) == 2 and result.tolerance is not None and len(rows := known[known["arm"] == arm.name])
    ]
    write_atomically(folder / RESULT_FILE, encode_document(result.model_dump(mode="json")))
    # What none of them exceeds by chance, with a probability of 95 %.
    ranks, n = result.rank_correlations, sum(arm.n for arm in result.arms)
    chance = float(ndtri(1.0 - 0.025 / max(1, sum(map(len, ranks.values()))))) / math.sqrt(max(1, n - 1))
    clear = {of: [key for key, rank in each.items() if abs(rank) > chance] for of, each in ranks.items()}
    # The keys that the page speaks of are its first figure, in that order, unless that is a map or the arms.
    spoken = dict.fromkeys(key for keys in clear.values() for key in keys)
    ordered = [] if maps else [*dict.fromkeys([*spoken, *ranges])]
    stated = dict(flatten(loaded.arms[0].protocol.model_dump(mode="json")))
    granted = {key: (of, stated.get(of), why) for key, of, why in _GRANTED}
    if _LENS in ranges and loaded.arms[0].rig is not None:
        granted[_LENS] = ("", load_plane_map(loaded.arms[0].rig).camera_distance_mm, "")
    first = 0 if result.pairs else min(max(1, len(spoken)), 3)
    front = draw_over_points(result, table, ordered[:first], granted, "over-first")
    points = draw_over_points(result, table, ordered[first:], granted, "over-points")
    for figure in filter(None, (arms := draw_arms(result, table), front, points, *dict(maps).values())):
        write_figure(folder, figure)
    shown = _tell(loaded, result, known, circles)
    shown |= {"chance": chance, "clear": clear, "granted": granted, "written": tell_writing(created)}
    shown |= {"arms_figure": arms, "front_figure": front, "points_figure": points, "maps": maps}
    page, template = folder / REPORT_FILE, Path(__file__).with_name("page.html.jinja")
    write_document(page, template, shown, {"words": name_settings, "with_key_unit": tell_value})
    return page


def _tell(
    loaded: LoadedCampaign, result: CampaignResult, known: pd.DataFrame, circles: Sequence[Circle]
) -> dict[str, Any]:
    """Return what the page tells that no figure shows; `known` are the tasks without an error, by their numbers."""
    points, missed = known[[*loaded.file.ranges]], ~(known["value"] <= (result.tolerance or 0.0))
    intervals = sorted(filter(None, (arm.ci95 for arm in result.arms)), key=np.ptp)
    return {
        "content": result,
        "quantity": split_quantity(result.measure),
        # The narrowest mean of several arms would print all of them too finely.
        "decimals": count_decimals(intervals[-1:], [arm.mean for arm in result.arms], 6),
        "bound_share": bound_share,
        "known": known,
        "failing": {of: known[rows] for of, rows in find_failing(known, result.measure).items()},
        "circles": circles,
        "gathered": _gather(points, missed, circles) if circles and missed.any() else None,
        "loaded": loaded,
        # The settings of more arms do not fit beside one another.
        "differing": [*find_differences(*(arm.describe() for arm in loaded.arms[:5]))],
        "sections": SECTIONS,
        "read_off": (SightingErrors(), ShaftErrors()),  # by a task that takes no pictures
        "provenance": collect_provenance(()),
    }


def _gather(points: pd.DataFrame, missed: "pd.Series[bool]", circles: Sequence[Circle]) -> tuple[float, ...]:
    """Return where that obstacle is which most missed points lie nearest to, along x, and how many of them do.

    Then within how many whole units of its edge these lie, and how many points do, missed or not.
    """
    places = np.array(circles)
    edges = np.linalg.norm(points.to_numpy(float)[:, None] - places[:, :2], axis=2) - places[:, 2]
    nearest = edges[missed].argmin(axis=1)
    most = int(np.bincount(nearest).argmax())
    within = math.ceil(edges[missed][nearest == most, most].max())
    return circles[most][0], int((nearest == most).sum()), within, int((edges[:, most] <= within).sum())
