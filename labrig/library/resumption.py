"""Continues a run after a crash, a power cut or a stop, on the same rig and with the protocol of its record."""

import shlex
from collections.abc import Mapping
from datetime import datetime
from functools import partial
from pathlib import Path

from labrig.devices.clocks import SystemClock
from labrig.devices.rig import Rig
from labrig.devices.rig_file import RigDescription, load_rig
from labrig.durable import require_free_bytes
from labrig.errors import FileFormatError, InputError, Problem, RecordError
from labrig.experiments.registry import find_run_experiment, load_run_protocol
from labrig.library.sources import find_recorded_rig, fit_rig, load_rig_for
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.check import check_run
from labrig.record.difference import find_differences
from labrig.record.events import UNENDED
from labrig.record.layout import find_rig_option, hash_file, is_simulated
from labrig.record.provenance import collect_code_diff, collect_provenance
from labrig.record.reader import Run, open_run
from labrig.record.writer import Recorder, close_interrupted_run, reopen_run
from labrig.runner.attendant import Attendant
from labrig.runner.conduct import Outcome, conduct
from labrig.runner.dialogue import Dialogue
from labrig.runner.dry_run import plan_run
from labrig.runner.experiment import Experiment
from labrig.runner.past import read_past
from labrig.runner.plan import count_needed_bytes, require_valid_calibration
from labrig.runner.run_record import RunOrder
from labrig.runner.session import Progress, Session
from labrig.runner.trials import Past
from labrig.runner.whole_run import FinishedRun, finish, record_on_rig
from labrig.runner.withdrawal import read_needle_path
from labrig.text import format_count

_NOT_THE_RIG = "faults"
"""The key of a rig file that does not describe the rig: faults are scripted for one session of a simulated rig."""


def resume_run(
    path: Path, rig: Path | None, command_line: tuple[str, ...], attendant: Attendant
) -> FinishedRun:
    """Make the remaining insertions of a run, measure it and write its report.

    Raises
    ------
    RecordError
        When it is not a run, or is damaged.
    FileFormatError
        When rig or calibration are not those of the run; each difference is a problem.
    InputError
        When nothing of such a run can be kept, or a block has no room for another entry point.
    LockedError, DiskError, BusError, DriveError, CameraError
        When it cannot continue; the record is unchanged.
    """
    run = _open_undamaged(path)
    if run.withdraws is not None:
        raise InputError(
            f"{path} is the withdrawal of the needle of run {run.withdraws}; it is not resumed",
            f"labrig devices withdraw continues it; labrig resume {path.parent / run.withdraws} continues that run",
        )
    if run.manifest.get("exit_status") == "success":
        attendant.say(f"{path} has come to its end; it is measured again, and that result counts")
        done = FinishedRun(path, Outcome("success", "", None))
        return finish(done, find_run_experiment(run), command_line, attendant)
    experiment = find_run_experiment(run)
    if not run.manifest.get("trials_planned"):
        raise InputError(
            f"a run of the experiment {experiment.name} is not continued: nothing of it can be kept",
            _suggest_alternative(run, experiment),
        )
    experiment.require_parts()
    recorded = load_run_protocol(run)
    description = _load_same_rig(run, recorded, rig)
    past = read_past(run)
    plan = plan_run(experiment, recorded, description, past)
    if plan.problems:
        raise FileFormatError(plan.problems)
    if not plan.trials:
        return finish(_close_without_rig(run, past, command_line), experiment, command_line, attendant)
    lost = (
        ", with those that were interrupted" if past.begun and past.begun[-1].exit_status in UNENDED else ""
    )
    told = f"{path}: {format_count(past.kept, 'trial')} ended before, {plan.trials} left{lost}"
    attendant.say(f"{told}; the protocol is that of its record")
    require_free_bytes(path, count_needed_bytes(plan, description))

    def begin(rig: Rig, progress: Progress) -> Session:
        require_valid_calibration(plan, rig)
        reopen = partial(_reopen_record, path, rig.clock.utc(), command_line, rig.describe())
        return Session(rig, rig.do_aside(reopen), progress)

    order = RunOrder(experiment, recorded, description, path.parent, path.name, command_line, {})
    go_on = partial(conduct, experiment, recorded, past=past)
    return finish(record_on_rig(order, plan, attendant, begin, go_on), experiment, command_line, attendant)


def _reopen_record(
    path: Path, started: datetime, command_line: tuple[str, ...], devices: Mapping[str, object]
) -> Recorder:
    """Reopen the record of a run that is continued now: with which code, by which command, on which devices."""
    recorder = reopen_run(path, " ".join(("labrig", *command_line[1:])))
    recorder.begin_session(
        started, code_diff=collect_code_diff(), provenance=collect_provenance(command_line), devices=devices
    )
    return recorder


def _suggest_alternative(run: Run, experiment: Experiment) -> str:
    """Return what to do about a run that cannot be continued."""
    if run.manifest.get("rig") is None:
        return "import the folder again"
    if is_simulated(run.manifest) or not experiment.moves_rig or not read_needle_path(run):
        return "run its protocol again"
    return (
        "if its needle is still in tissue, take it out along its path: "
        f"labrig devices withdraw {find_rig_option(run.manifest)} --run {shlex.quote(str(run.path))}; "
        "then run its protocol again"
    )


def _open_undamaged(path: Path) -> Run:
    verdict = check_run(path)
    if verdict.damage:
        first, count = verdict.damage[0], len(verdict.damage)
        raise RecordError(
            f"{path} is damaged in {count} places: {first.where}: {first.message}", "see: labrig runs check"
        )
    return open_run(path)


def _load_same_rig(run: Run, protocol: ExperimentProtocol, given: Path | None) -> RigDescription:
    """Return the rig of a run, from the file that is named now or was then; refuse one that has changed since."""
    kept, settings = find_recorded_rig(run.path, run.manifest)
    file = given or kept
    if run.rig_path is None or file is None:
        raise InputError(f"{run.path} does not say which rig file it had", "name it with --rig FILE")
    unscripted = [setting for setting in settings if not setting.startswith(_NOT_THE_RIG)]
    description = fit_rig(protocol, load_rig_for(protocol, file, file, unscripted))
    if description is None:
        raise InputError(f"{run.path} moves no rig", "run its protocol again")
    before, now = (
        each.model_dump(mode="json", exclude={_NOT_THE_RIG}) for each in (load_rig(run.rig_path), description)
    )
    changed = [(f"{file} {key}", a, b) for key, (a, b) in find_differences(before, now)]
    hashes = {name: hash_file(path) for name, path in description.calibration_files().items()}
    for name, (a, b) in find_differences(run.calibration_hashes, hashes):
        changed.append((f"calibration {name}", f"SHA-256 {a}", b))
    if changed:
        hint = "a run continues with what it began with: restore that, or start a new run"
        told = (Problem(where, f"the run began with {a}, now it is {b}", hint) for where, a, b in changed)
        raise FileFormatError(tuple(told))
    return description


def _close_without_rig(run: Run, past: Past, command_line: tuple[str, ...]) -> FinishedRun:
    """Close a run that was interrupted after its last insertion; one that has failed by its insertions is closed."""
    dialogue = Dialogue(planned=run.manifest["trials_planned"])
    dialogue.recall(past)
    error = dialogue.find_failure()
    outcome = Outcome("success", "", None) if error is None else Outcome("failed", error.reason, error)
    if outcome.exit_status != run.manifest.get("exit_status"):
        doing = " ".join(("labrig", *command_line[1:]))
        close_interrupted_run(run.path, doing, SystemClock().utc(), outcome.exit_status, outcome.reason)
    return FinishedRun(run.path, outcome)
