"""Reads what the record of an interrupted run holds, for the session that continues it."""

import math
from collections.abc import Iterator, Sequence

import pandas as pd

from labrig.devices.past_insertion import PastInsertion
from labrig.record.events import TrialStart, TrialStop
from labrig.record.reader import Run
from labrig.runner.trials import Past
from labrig.runner.withdrawal import read_needle_path


class _HoleStart(TrialStart):
    """A trial that starts, with its hole if it has one."""

    specimen: str = ""
    gelatin_percent: float = 0.0
    hole: int = 0
    hole_position_mm: float = 0.0


def read_past(run: Run) -> Past:
    """Return what a record holds. Raises `RecordError` when it is damaged."""
    trials = run.read_trials(_HoleStart, TrialStop)
    starts = [trial.start for trial in trials if trial.start.specimen]
    return Past(trials, run.decisions, tuple(_list_holes(run.states, starts)), read_needle_path(run))


def _list_holes(states: pd.DataFrame, starts: Sequence[_HoleStart]) -> Iterator[PastInsertion]:
    ends_s = [*(start.t_s for start in starts), math.inf][1:]
    for start, end_s in zip(starts, ends_s, strict=True):
        during = states[(states["t_s"] >= start.t_s) & (states["t_s"] < end_s)]
        path = zip(during["insertion_mm"], during["rotation_rad"], during["linear_mm"], strict=True)
        yield PastInsertion(
            specimen=start.specimen,
            gelatin_percent=start.gelatin_percent,
            hole=start.hole,
            hole_position_mm=start.hole_position_mm,
            path=tuple((float(a), float(b), float(c)) for a, b, c in path),
        )
