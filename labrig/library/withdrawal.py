"""Withdraws a needle that a run has left in tissue; the withdrawal is a run of its own, beside that one."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from labrig.devices.needle_state import NeedleState
from labrig.devices.opening import Opening
from labrig.devices.rig import Rig
from labrig.devices.rig_file import RigDescription
from labrig.errors import InputError, MachineError
from labrig.input_file import read_file
from labrig.protocol.yaml_file import dump_yaml
from labrig.record.layout import WITHDRAWS
from labrig.record.provenance import collect_code_diff, collect_provenance
from labrig.record.reader import Run, open_run
from labrig.record.writer import Recorder, create_under_free_name, opening_files
from labrig.runner.attendant import Attendant
from labrig.runner.conduct import conduct_withdrawal
from labrig.runner.needle_report import report_needle
from labrig.runner.session import Session
from labrig.runner.whole_run import FinishedRun
from labrig.runner.withdrawal import read_needle_path

_DOING = "labrig devices withdraw"


def withdraw_needle(
    rig: RigDescription,
    run: Path | None,
    runs_dir: Path,
    *,
    standing: Mapping[str, float],
    attendant: Attendant,
    command_line: Sequence[str],
) -> FinishedRun:
    """Withdraw a needle along the path that is recorded.

    Parameters
    ----------
    run : Path or None
        The run that left the needle, by its folder or its name in `runs_dir`; None: the run that the rig remembers.
    standing : mapping
        Field of `AxisPositions` -> position of that axis, if the end of the record is not right.

    Raises
    ------
    InputError
        When no needle is in tissue, another run left it, or the record holds no path.
    """
    left = _open_run_with_needle(rig, run, runs_dir)
    path = read_needle_path(left)
    if not path:
        raise InputError(
            f"{left.path} holds no path: its needle was out, or nothing had moved",
            "look whether a needle is in tissue; the next labrig run asks to confirm that none is",
        )
    opening = Opening(camera=False, reset_faults=True, hold_inputs=False, power=False)
    ended: FinishedRun | None = None
    try:
        with (
            attendant.open_rig(rig, _DOING, 0, opening) as (opened, _),
            attendant.progress("withdrawal", 1.0) as progress,
        ):
            begin = partial(_begin_record, opened, left, opened.describe(), command_line)
            session = Session(opened, opened.do_aside(begin), progress)
            outcome = conduct_withdrawal(session, left.path.name, path, replace(path[-1], **standing))
            recorded = session.recorder.path
            ended = FinishedRun(recorded, outcome, report_needle(opened, recorded))
    except MachineError as failure:
        if ended is None:
            raise
        ended = replace(ended, outcome=ended.outcome.add(failure, "closing"))
    return ended


def _open_run_with_needle(rig: RigDescription, given: Path | None, runs_dir: Path) -> Run:
    state = NeedleState(rig.state_path).state
    if state.needle_in_tissue is False:
        raise InputError(
            f"no needle is in tissue, as rig {rig.name} remembers",
            "there is nothing to withdraw; labrig devices jog --axis NAME moves an axis",
        )
    if rig.kind == "simulated":
        raise InputError(
            f"{rig.name}: a simulated rig has new gel whenever it is opened, with no needle in it",
            "the next labrig run on it asks to confirm that none is, and forgets this one",
        )
    if given is None and state.since_run is None:
        raise InputError(
            f"it is not known which run left a needle, if any: {state.doubt}",
            "name the run with --run RUN; if no needle is in tissue, labrig devices jog and home move the axes",
        )
    named = Path(str(state.since_run)) if given is None else given
    found = open_run(named if named.exists() else runs_dir / named)
    name = found.path.resolve().name
    if state.since_run not in {None, name}:
        raise InputError(
            f"the needle was left by run {state.since_run}, not by {name}",
            f"{_DOING} {rig.option} --run {found.path.parent / str(state.since_run)}",
        )
    return found


def _begin_record(
    rig: Rig, left: Run, devices: Mapping[str, object], command_line: Sequence[str]
) -> Recorder:
    started, folder = rig.clock.utc(), left.path.resolve()
    manifest = {
        "experiment": "withdrawal",
        "title": f"withdrawal of the needle of run {folder.name}",
        "started": started.isoformat(timespec="seconds"),
        "provenance": collect_provenance(command_line),
        "plugins": {plugin.title: plugin.origin for plugin in rig.description.plugins},
        "protocol": dict(left.protocol),
        "devices": devices,
        WITHDRAWS: folder.name,
    }
    protocol, diff = read_file(left.protocol_path).decode(), collect_code_diff()
    files = opening_files(protocol, dump_yaml(rig.description), code_diff=diff)
    create = partial(Recorder.create, folder.parent, manifest=manifest, files=files)
    return create_under_free_name(started, "withdrawal", create)
