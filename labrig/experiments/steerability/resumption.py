"""Going on with a sweep that was interrupted: what its record holds, and what is done before the next insertion."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import pandas as pd

from labrig.devices.operator import ConfirmNeedleOut, WithdrawNeedle
from labrig.devices.past_insertion import PastInsertion
from labrig.experiments.steerability.events import SweepTrialStart, SweepTrialStop
from labrig.experiments.steerability.procedure import make_insertions, mount_and_reference
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.experiments.steerability.schedule import BegunTrial, remaining_trials
from labrig.record.events import INTERRUPTED, TrialStop
from labrig.record.reader import Run
from labrig.runner.axis_positions import AxisPositions
from labrig.runner.experiment import Remainder
from labrig.runner.session import Session
from labrig.runner.withdrawal import recorded_path, withdraw


@dataclass(frozen=True)
class Past:
    """What a record holds of a sweep that is to be continued.

    Attributes
    ----------
    begun : tuple of BegunTrial
        Its insertions so far.
    insertions : tuple of PastInsertion
        The same, as a gel remembers them.
    needle_path : tuple of AxisPositions
        How the needle came to where it was last seen; empty where it was out.
    """

    begun: tuple[BegunTrial, ...]
    insertions: tuple[PastInsertion, ...]
    needle_path: tuple[AxisPositions, ...]


def resume(protocol: SteerabilityProtocol, run: Run) -> Remainder:
    """Return what is left of a sweep that was interrupted.

    Raises
    ------
    InputError
        When a block has no room for another entry point.
    RecordError
        When the record is damaged.
    """
    begun = run.read_trials(SweepTrialStart, SweepTrialStop)
    insertions = tuple(_insertions(run.states, [trial.start for trial in begun]))
    past = Past(begun, insertions, recorded_path(run))
    kept = sum(trial.exit_status == "success" for trial in begun)
    left = remaining_trials(protocol, begun)
    return Remainder(kept, len(left), partial(_go_on, protocol, past))


def _insertions(states: pd.DataFrame, starts: Sequence[SweepTrialStart]) -> Iterator[PastInsertion]:
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


def _go_on(protocol: SteerabilityProtocol, past: Past, session: Session) -> None:
    """Mark what was interrupted, see that the needle is out, and make the insertions that are left.

    Nothing is homed or referenced before the needle is known to be out.
    """
    left = remaining_trials(protocol, past.begun)
    for trial in past.begun:
        if trial.stop is None:
            session.record(TrialStop(trial=trial.start.trial, exit_status=INTERRUPTED))
    _take_needle_out(session, past.needle_path)
    mount_and_reference(protocol, session)
    session.rig.recall(past.insertions)
    make_insertions(protocol, left, session)


def _take_needle_out(session: Session, path: Sequence[AxisPositions]) -> None:
    """Withdraw a needle that this run left in tissue along its path if the operator agrees; else ask whether it is out.

    It can be withdrawn only where every drive has kept its reference; elsewhere nobody knows where it stands.
    """
    rig = session.rig
    if rig.state.needle_in_tissue is False:
        return
    of_this_run = rig.state.since_run == session.recorder.run_name
    if path and of_this_run and all(axis.referenced for axis in rig.axes):
        deepest_mm = max(positions.insertion_mm for positions in path)
        if session.offer(WithdrawNeedle(session.recorder.run_name, deepest_mm)):
            withdraw(session, path)
            return
    session.ask(ConfirmNeedleOut(rig.state.doubt))
    rig.needle.mark_out()
