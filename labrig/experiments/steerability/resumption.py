"""Resumes an interrupted sweep: reads what its record holds, and takes the needle out before the next insertion."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import pandas as pd

from labrig.devices.axis_positions import AxisPositions
from labrig.devices.operator import ConfirmUnchanged
from labrig.devices.past_insertion import PastInsertion
from labrig.experiments.steerability.events import SweepTrialStart, SweepTrialStop
from labrig.experiments.steerability.procedure import make_insertions, mount_and_reference
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.experiments.steerability.schedule import BegunTrial, list_remaining_trials
from labrig.protocol.sections import TrackedSpecimen
from labrig.record.events import INTERRUPTED, TrialStop
from labrig.record.reader import Run
from labrig.runner.experiment import Remainder
from labrig.runner.session import Session
from labrig.runner.withdrawal import read_needle_path, take_needle_out


@dataclass(frozen=True)
class Past:
    """The part of a sweep that is already recorded.

    Attributes
    ----------
    begun : tuple of BegunTrial
        Its insertions so far.
    insertions : tuple of PastInsertion
        The same, as a gel remembers them.
    needle_path : tuple of AxisPositions
        The path of a needle that may still be in tissue; empty if it was out.
    """

    begun: tuple[BegunTrial, ...]
    insertions: tuple[PastInsertion, ...]
    needle_path: tuple[AxisPositions, ...]


def resume(protocol: SteerabilityProtocol, run: Run) -> Remainder:
    """Return the rest of an interrupted sweep.

    Raises
    ------
    InputError
        When a block has no room for another entry point.
    RecordError
        When the record is damaged.
    """
    begun = run.read_trials(SweepTrialStart, SweepTrialStop)
    insertions = tuple(_list_insertions(run.states, [trial.start for trial in begun]))
    past = Past(begun, insertions, read_needle_path(run))
    kept = sum(trial.exit_status == "success" for trial in begun)
    left = list_remaining_trials(protocol, begun, run.decisions)
    return Remainder(kept, len(left), partial(_continue_sweep, protocol, past))


def _list_insertions(states: pd.DataFrame, starts: Sequence[SweepTrialStart]) -> Iterator[PastInsertion]:
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


def _continue_sweep(protocol: SteerabilityProtocol, past: Past, session: Session) -> None:
    """Mark interrupted trials, make sure that the needle is out, and make the remaining insertions.

    Nothing is homed or referenced before the needle is known to be out.
    """
    for trial in past.begun:
        if trial.stop is None:
            session.record(TrialStop(trial=trial.start.trial, exit_status=INTERRUPTED))
    take_needle_out(session, past.needle_path)
    placed = _find_placed(protocol, past, session)
    if placed is None:
        mount_and_reference(protocol, session)
    session.recall(past.insertions)
    make_insertions(protocol, session, past.begun, placed)


def _find_placed(protocol: SteerabilityProtocol, past: Past, session: Session) -> TrackedSpecimen | None:
    """Return the specimen in the frame if the operator confirms that all is as it was; None: it is asked for again."""
    if not past.begun or not session.stands_at_start():
        return None
    name = past.begun[-1].start.specimen
    specimen = next((specimen for specimen in protocol.specimens if specimen.name == name), None)
    as_it_was = ConfirmUnchanged(session.run_name, protocol.needle.needle_id, name)
    return specimen if specimen is not None and session.offer(as_it_was) else None
