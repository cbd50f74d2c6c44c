"""A sweep goes on after a crash, a power cut or a stop, on the rig and by the protocol that it had."""

import json
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

from labrig.cli.finished_run import FinishedRun
from labrig.cli.output import say
from labrig.cli.pipeline import Recorded, conclude, record_on_rig
from labrig.cli.progress import Reporter
from labrig.cli.sources import Sources, recorded_sources
from labrig.devices.clocks import SystemClock
from labrig.devices.rig import Rig
from labrig.devices.rig_file import RigDescription, load_rig
from labrig.errors import FileFormatError, InputError, Problem, RecordError
from labrig.experiments.registry import experiment_of, protocol_of
from labrig.protocol.model import Model
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.check import check_run
from labrig.record.difference import find_differences
from labrig.record.durable import require_free_bytes
from labrig.record.events import RunStop
from labrig.record.provenance import collect_code_diff, collect_provenance
from labrig.record.reader import Run, open_run
from labrig.record.writer import Recorder
from labrig.runner.conduct import Outcome, conduct_remainder
from labrig.runner.experiment import Experiment, Remainder
from labrig.runner.plan import estimate
from labrig.runner.session import Session
from labrig.runner.withdrawal import recorded_path

_NOT_THE_RIG = ("faults",)
"""What a rig file holds beside how the rig stands: faults are scripted for one session of a simulated rig."""


@dataclass(frozen=True)
class Continuation:
    """A run that can be continued: what is left of it, on which rig, and the command that said so."""

    run: Run
    experiment: Experiment
    protocol: ExperimentProtocol
    remainder: Remainder
    rig: RigDescription
    command_line: tuple[str, ...]


def resume_run(
    path: Path, protocol: Path | None, rig: Path | None, command_line: tuple[str, ...]
) -> FinishedRun:
    """Make the insertions that are left of a run, measure it and write its report.

    Raises
    ------
    RecordError
        When it is no run, or is damaged.
    FileFormatError
        When protocol, rig or calibration are not those of the run; each difference is a problem.
    InputError
        When nothing of such a run can be kept, or a block has no room for another entry point.
    LockedError, DiskError, BusError, DriveError, CameraError
        When it cannot go on; the record is as it was.
    """
    run = _undamaged(path)
    if run.withdraws is not None:
        raise InputError(
            f"{path} is the withdrawal of the needle of run {run.withdraws}; it is not resumed",
            f"labrig devices withdraw goes on with it; labrig resume {path.parent / run.withdraws} with that run",
        )
    if run.manifest.get("exit_status") == "success":
        say(f"{path} has come to its end; it is measured again")
        return conclude(Recorded(path, Outcome("success", "", None), "", None), command_line)
    experiment = experiment_of(run)
    if not experiment.can_resume:
        raise InputError(
            f"a run of the experiment {experiment.name} is not continued: nothing of it can be kept",
            _instead(run, experiment),
        )
    experiment.require_parts()
    recorded = protocol_of(run)
    description = _unchanged(run, recorded, _sources(run, protocol, rig))
    remainder = experiment.resume(recorded, run)
    if not remainder.left:
        return conclude(_closed_without_rig(path, command_line), command_line)
    say(f"{path}: {remainder.kept} insertions are kept, {remainder.left} are left")
    continuation = Continuation(run, experiment, recorded, remainder, description, command_line)
    plan = experiment.plan(recorded, description)
    needs = estimate(plan, description)
    share = remainder.left / plan.trials
    least_free_mb = description.recording.least_free_mb
    require_free_bytes(path, int(share * needs.disk_bytes + 1e6 * least_free_mb))
    return conclude(_record_rest(continuation, needs.work), command_line)


def _instead(run: Run, experiment: Experiment) -> str:
    """Return what to do about a run that cannot be continued."""
    devices = run.manifest.get("devices")
    if not devices:
        return "import the folder again, or close the run as it stands: labrig runs check --repair"
    simulated = isinstance(devices, Mapping) and devices.get("kind") == "simulated"
    if simulated or not experiment.puts_needle_in_tissue or not recorded_path(run):
        return "run its protocol again"
    return (
        "if its needle is still in tissue, take it out along its path: "
        f"labrig devices withdraw --rig FILE --run {shlex.quote(str(run.path))}; then run its protocol again"
    )


def _undamaged(path: Path) -> Run:
    verdict = check_run(path)
    if verdict.damage:
        first, count = verdict.damage[0], len(verdict.damage)
        raise RecordError(
            f"{path} is damaged in {count} places: {first.where}: {first.message}", "see: labrig runs check"
        )
    return open_run(path)


def _sources(run: Run, protocol: Path | None, rig: Path | None) -> Sources:
    """Return where protocol and rig are read again: as named now, else as named when the run was started."""
    kept = recorded_sources(run.manifest)
    if kept is None:
        if rig is None:
            raise InputError(f"{run.path} does not say which rig file it had", "name it with --rig FILE")
        kept = Sources(run.path / "protocol.yaml", rig, (), None)
    settings = tuple(one for one in kept.settings if not one.startswith("rig.faults"))
    sources = replace(kept, protocol=protocol or kept.protocol, rig=rig or kept.rig, settings=settings)
    if not sources.protocol.exists() and protocol is None:
        say(f"note: {sources.protocol} is not here; the protocol of the record is taken")
        seed_and_values = tuple(one for one in settings if one.startswith("rig."))
        return replace(sources, protocol=run.path / "protocol.yaml", settings=seed_and_values, seed=None)
    return sources


def _unchanged(run: Run, recorded: ExperimentProtocol, sources: Sources) -> RigDescription:
    """Return the rig if it, the protocol and the calibration are what the run began with."""
    protocol, description = sources.load()
    if description is None or run.rig_path is None:
        raise InputError(f"{run.path} moves no rig", "run its protocol again")
    problems = [
        *_differences(str(sources.protocol), _values(recorded), _values(protocol)),
        *_differences(str(sources.rig), _values(load_rig(run.rig_path)), _values(description)),
        *_calibration_differences(run, description),
    ]
    if problems:
        raise FileFormatError(tuple(problems))
    return description


def _values(model: Model) -> dict[str, Any]:
    return {key: value for key, value in model.model_dump(mode="json").items() if key not in _NOT_THE_RIG}


def _differences(where: str, recorded: object, now: object) -> Iterator[Problem]:
    for key, before, after in find_differences(recorded, now):
        yield Problem(
            f"{where} {key}",
            f"the run began with {before}, now it is {after}",
            "a run goes on with what it began with: restore that, or start a new run",
        )


def _calibration_differences(run: Run, description: RigDescription) -> Iterator[Problem]:
    files = description.calibration_files()
    hashes = run.manifest.get("hashes")
    recorded = hashes.get("calibration", {}) if isinstance(hashes, Mapping) else {}
    for name in sorted({*recorded, *files}):
        now = files[name].read_bytes() if name in files else b""
        digest = sha256(now).hexdigest() if name in files else None
        if digest != recorded.get(name):
            yield Problem(
                f"calibration {name}",
                f"the run began with SHA-256 {_short(recorded.get(name))}, now it is {_short(digest)}",
                "a run goes on with what it began with: restore that file, or start a new run",
            )
            if name in files and name in recorded and name.endswith(".json"):
                before = run.calibration_path(name).read_bytes()
                yield from _differences(f"calibration {name}", json.loads(before), json.loads(now))


def _short(digest: object) -> str:
    return "none" if digest is None else f"{str(digest)[:12]}..."


def _closed_without_rig(path: Path, command_line: tuple[str, ...]) -> Recorded:
    """Close a run that was interrupted when every insertion had been made."""
    clock = SystemClock()
    recorder = Recorder.reopen(path, " ".join(("labrig", *command_line[1:])))
    recorder.record_event(RunStop(exit_status="success", reason=""), 0.0)
    recorder.close("success", "", clock.utc())
    return Recorded(path, Outcome("success", "", None), "", None)


def _record_rest(continuation: Continuation, work: float) -> Recorded:
    command_line = continuation.command_line

    def act(rig: Rig, reporter: Reporter) -> tuple[Path, Outcome]:
        recorder = Recorder.reopen(continuation.run.path, " ".join(("labrig", *command_line[1:])))
        recorder.begin_session(
            rig.clock.utc(),
            code_diff=collect_code_diff(),
            provenance=collect_provenance(command_line),
            devices=rig.describe(),
        )
        session = Session(rig, recorder, reporter)
        return recorder.path, conduct_remainder(continuation.experiment, continuation.remainder, session)

    return record_on_rig(
        continuation.experiment, continuation.protocol, continuation.rig, work, command_line, act
    )
