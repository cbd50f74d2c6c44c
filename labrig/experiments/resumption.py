"""Going on with a sweep that was interrupted: what its record holds, and what is done before the next insertion."""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from labrig.devices.operator import ConfirmNeedleOut, WithdrawNeedle
from labrig.devices.past import PastInsertion
from labrig.errors import InputError
from labrig.experiments.schedule import BegunTrial, PlannedTrial, rest_of_sweep
from labrig.experiments.session import Session
from labrig.experiments.stance import Stance
from labrig.experiments.steerability import make_insertions, mount_and_reference
from labrig.experiments.withdrawal import recorded_path, withdraw
from labrig.protocol.protocols import ImportProtocol, SteerabilityProtocol
from labrig.record.events import TrialStop
from labrig.record.reader import Run

INTERRUPTED = "interrupted"
"""How a trial ended that a later session found without an end."""


@dataclass(frozen=True)
class Past:
    """What a record holds of a sweep that is to be continued.

    Attributes
    ----------
    begun : tuple of BegunTrial
        Its insertions so far.
    insertions : tuple of PastInsertion
        The same, as a gel remembers them.
    unmarked : tuple of int
        Trials that have no end yet.
    needle_path : tuple of Stance
        How the needle came to where it was last seen; empty where it was out.
    """

    begun: tuple[BegunTrial, ...]
    insertions: tuple[PastInsertion, ...]
    unmarked: tuple[int, ...]
    needle_path: tuple[Stance, ...]


def past_of(run: Run) -> Past:
    """Read what a run holds of its sweep.

    Raises
    ------
    InputError
        When the experiment has no insertions that could be kept.
    RecordError
        When the record is damaged.
    """
    if not isinstance(run.protocol, SteerabilityProtocol):
        raise InputError(
            f"a run of the experiment {run.protocol.experiment} is not continued: nothing of it can be kept",
            _instead(run),
        )
    rows: list[dict[str, Any]] = run.trials.to_dict("records")  # type: ignore[assignment]
    return Past(
        begun=tuple(_begun(row) for row in rows),
        insertions=tuple(_insertions(run.states, rows)),
        unmarked=tuple(int(row["trial"]) for row in rows if row["exit_status"] == "incomplete"),
        needle_path=recorded_path(run),
    )


def _instead(run: Run) -> str:
    """Return what to do about a run that cannot be continued."""
    if isinstance(run.protocol, ImportProtocol):
        return "import the folder again, or close the run as it stands: labrig runs check --repair"
    devices = run.manifest.get("devices")
    simulated = isinstance(devices, Mapping) and devices.get("kind") == "simulated"
    if simulated or not recorded_path(run):
        return "run its protocol again"
    return (
        "if its needle is still in tissue, take it out along its path: "
        f"labrig devices withdraw --rig FILE --run {shlex.quote(str(run.path))}; then run its protocol again"
    )


def _begun(row: dict[str, Any]) -> BegunTrial:
    repeats = row.get("repeats")
    return BegunTrial(
        trial=int(row["trial"]),
        specimen=str(row["specimen"]),
        hole=int(row["hole"]),
        hole_position_mm=float(row["hole_position_mm"]),
        finished=row["exit_status"] == "success",
        repeats=None if repeats is None or pd.isna(repeats) else int(repeats),
    )


def _insertions(states: pd.DataFrame, rows: Sequence[dict[str, Any]]) -> Iterator[PastInsertion]:
    starts_s = [float(row["start_t_s"]) for row in rows]
    for row, start_s, end_s in zip(rows, starts_s, [*starts_s, float("inf")][1:], strict=True):
        during = states[(states["t_s"] >= start_s) & (states["t_s"] < end_s)]
        path = zip(during["insertion_mm"], during["rotation_rad"], during["linear_mm"], strict=True)
        yield PastInsertion(
            specimen=str(row["specimen"]),
            gelatin_percent=float(row["gelatin_percent"]),
            hole=int(row["hole"]),
            hole_position_mm=float(row["hole_position_mm"]),
            path=tuple((float(a), float(b), float(c)) for a, b, c in path),
        )


def trials_left(protocol: SteerabilityProtocol, past: Past) -> tuple[PlannedTrial, ...]:
    """Return the insertions that are still to be made. Raises `InputError` where a block has no room for one."""
    return rest_of_sweep(protocol, past.begun)


def resume_steerability(protocol: SteerabilityProtocol, session: Session, past: Past) -> int:
    """Mark what was interrupted, see that the needle is out, and make the insertions that are left.

    Returns how many were made. Nothing is homed or referenced before the needle is known to be out.
    """
    left = trials_left(protocol, past)
    for trial in past.unmarked:
        session.record(TrialStop(trial=trial, exit_status=INTERRUPTED))
    _take_needle_out(session, past.needle_path)
    mount_and_reference(protocol, session)
    session.rig.recall(past.insertions)
    return make_insertions(protocol, left, session)


def _take_needle_out(session: Session, path: Sequence[Stance]) -> None:
    """Withdraw a needle that this run left in tissue along its path if the operator agrees; else ask whether it is out.

    It can be withdrawn only where every drive has kept its reference; elsewhere nobody knows where it stands.
    """
    rig = session.rig
    if rig.state.needle_in_tissue is False:
        return
    of_this_run = rig.state.since_run == session.recorder.run_name
    if path and of_this_run and all(axis.referenced for axis in rig.axes):
        deepest_mm = max(stance.insertion_mm for stance in path)
        if session.offer(WithdrawNeedle(session.recorder.run_name, deepest_mm)):
            withdraw(session, path)
            return
    session.ask(ConfirmNeedleOut(rig.state.doubt))
    rig.needle.mark_out()
