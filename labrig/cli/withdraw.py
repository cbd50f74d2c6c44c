"""Withdraws a needle that a run has left in tissue, from the command line."""

import sys
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

from labrig.cli.finished_run import say_where_needle_is
from labrig.cli.output import failure_document, failure_lines, print_json, print_line, say
from labrig.cli.progress import progress
from labrig.cli.rigs import open_rig_for_person, remark_on_yes
from labrig.devices.axis_positions import AxisPositions
from labrig.devices.needle_state import NeedleState
from labrig.devices.opening import Opening
from labrig.devices.rig import Rig
from labrig.devices.rig_file import RigDescription, load_rig
from labrig.errors import InputError, MachineError
from labrig.input_file import read_file
from labrig.library.names import find_rig_file
from labrig.protocol.yaml_file import dump_yaml
from labrig.record.layout import WITHDRAWS
from labrig.record.manifest import read_checksum
from labrig.record.provenance import collect_code_diff, collect_provenance, find_code_changes
from labrig.record.reader import Run, open_run
from labrig.record.writer import Recorder, RunFiles, create_under_free_name
from labrig.runner.conduct import Outcome, conduct_withdrawal
from labrig.runner.needle_report import NeedleReport, add_closing_failure, report_needle
from labrig.runner.supervised_record import begin_session
from labrig.runner.withdrawal import read_needle_path


def withdraw_and_print(
    rig: Path | None,
    run: Path | None,
    runs_dir: Path,
    standing: Mapping[str, float],
    *,
    yes: bool,
    as_json: bool,
) -> int:
    """Withdraw the needle and print how it ended.

    Parameters
    ----------
    run : Path or None
        The run that left the needle; None: the run that the rig remembers, in `runs_dir`.
    standing : mapping
        Field of `AxisPositions` -> position of that axis, if the end of the record is not right.

    Raises
    ------
    InputError
        When no needle is in tissue, another run left it, or the record holds no path.
    """
    description = load_rig(find_rig_file(rig))
    remark_on_yes(description, yes=yes)
    left = _open_run_with_needle(description, run, runs_dir)
    path = read_needle_path(left)
    if not path:
        raise InputError(
            f"{left.path} holds no path: its needle was out, or nothing had moved",
            "look whether a needle is in tissue; the next labrig run asks to confirm that none is",
        )
    recorded, outcome, needle = _withdraw(description, left, path, replace(path[-1], **standing))
    checksum = read_checksum(recorded)
    document: dict[str, object] = {
        "run": str(recorded),
        "exit_status": outcome.exit_status,
        "reason": outcome.reason or None,
        "checksum": checksum,
        "needle": needle.document(),
    }
    if outcome.error is not None:
        document["error"] = failure_document(outcome.error)
        say_where_needle_is(needle)
        for line in failure_lines(outcome.error):
            say(line)
        say(f"again: {_make_retry_command(description, runs_dir, recorded)}\nthe record is kept: {recorded}")
    if as_json:
        print_json(document)
    elif outcome.error is None:
        print_line(f"the needle is out\nrecord  {recorded}\nchecksum {checksum}")
    return 0 if outcome.error is None else outcome.error.exit_code


def _make_retry_command(description: RigDescription, runs_dir: Path, recorded: Path) -> str:
    """Return the command that continues a withdrawal, with the run that the rig remembers."""
    since = NeedleState(description.state_path).state.since_run
    folder = recorded.parent if recorded.parent != Path() else runs_dir
    return f"labrig devices withdraw {description.option} --run {folder / str(since)}"


def _open_run_with_needle(description: RigDescription, given: Path | None, runs_dir: Path) -> Run:
    """Return the run that left the needle in tissue."""
    state = NeedleState(description.state_path).state
    if state.needle_in_tissue is False:
        raise InputError(
            f"no needle is in tissue, as rig {description.name} remembers",
            "there is nothing to withdraw; labrig devices jog --axis NAME moves an axis",
        )
    if description.kind == "simulated":
        raise InputError(
            f"{description.name}: a simulated rig has new gel whenever it is opened, with no needle in it",
            "run the protocol again",
        )
    if given is None and state.since_run is None:
        raise InputError(
            f"it is not known which run left a needle, if any: {state.doubt}",
            "name the run with --run RUN; if no needle is in tissue, labrig devices jog and home move the axes",
        )
    found = open_run(_find_folder(given if given is not None else Path(str(state.since_run)), runs_dir))
    folder = found.path.resolve()
    if state.since_run not in {None, folder.name}:
        raise InputError(
            f"the needle was left by run {state.since_run}, not by {folder.name}",
            f"labrig devices withdraw {description.option} --run {found.path.parent / str(state.since_run)}",
        )
    return found


def _find_folder(given: Path, runs_dir: Path) -> Path:
    """Return the folder of a run that is given by its folder or, as in hints, by its name in `runs_dir`."""
    return given if given.exists() else runs_dir / given


def _withdraw(
    description: RigDescription, left: Run, path: tuple[AxisPositions, ...], standing: AxisPositions
) -> tuple[Path, Outcome, NeedleReport]:
    opening = Opening(camera=False, reset_faults=True, hold_inputs=False, power=False)
    ended: tuple[Path, Outcome, NeedleReport] | None = None
    try:
        with (
            open_rig_for_person(description, "labrig devices withdraw", opening=opening) as (rig, _),
            progress("withdrawal", 1.0) as reporter,
        ):
            session = begin_session(rig, partial(_begin_record, rig, left, rig.describe()), reporter)
            outcome = conduct_withdrawal(session, left.path.name, path, standing)
            ended = session.recorder.path, outcome, report_needle(rig, session.recorder.path)
    except MachineError as failure:
        if ended is None:
            raise
        return ended[0], add_closing_failure(ended[1], failure), ended[2]
    return ended


def _begin_record(rig: Rig, left: Run, devices: Mapping[str, object]) -> Recorder:
    """Begin the record of a withdrawal beside the run whose needle is withdrawn."""
    started = rig.clock.utc()
    folder = left.path.resolve()
    changes = find_code_changes()
    manifest = {
        "experiment": "withdrawal",
        "title": f"withdrawal of the needle of run {folder.name}",
        "started": started.isoformat(timespec="seconds"),
        "provenance": collect_provenance(tuple(sys.argv), changes),
        "plugins": {plugin.title: plugin.origin for plugin in rig.description.plugins},
        "protocol": dict(left.protocol),
        "devices": devices,
        WITHDRAWS: folder.name,
    }
    files = RunFiles(
        read_file(left.protocol_path).decode(),
        dump_yaml(rig.description),
        code_diff=collect_code_diff(changes),
    )
    create = partial(Recorder.create, folder.parent, manifest=manifest, files=files)
    return create_under_free_name(started, "withdrawal", create)
