"""The specimens of a protocol before a run: the tracks that are in them, and whether they are of an age to be used."""

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from labrig.devices.can_description import ONLY_SIMULATED
from labrig.devices.rig_file import RigDescription
from labrig.errors import FileFormatError, LabrigError, Problem, RecordError
from labrig.experiments.registry import load_run_protocol
from labrig.experiments.shared.needle_events import SpecimenTrialStart
from labrig.protocol.sections import ExperimentProtocol
from labrig.protocol.specimen_file import (
    MOST_TRACKS,
    SpecimenFile,
    SpecimenSection,
    SpecimenTrack,
    TracksBySpecimen,
)
from labrig.record.catalogue import list_runs
from labrig.record.condition import BLOCK_NAME
from labrig.record.layout import COPY_HINT, is_simulated
from labrig.record.reader import Run, open_run


@dataclass(frozen=True)
class PreparedSpecimens:
    """A protocol with the old tracks in its specimens, and what is wrong or doubtful about these."""

    protocol: ExperimentProtocol
    problems: tuple[Problem, ...] = ()
    warnings: tuple[Problem, ...] = ()


def prepare_specimens(
    protocol: ExperimentProtocol, rig: RigDescription | None, runs_dir: Path, now: datetime
) -> PreparedSpecimens:
    """Return a protocol with the tracks that the runs of a folder have left in its specimens.

    The tracks of simulated runs count for simulated runs alone, and those of real ones for real ones.

    Raises
    ------
    InputError
        When the folder cannot be read.
    """
    named = {key: gel.block for key, gel in protocol.gels.items() if gel.block is not None}
    if not named or rig is None:
        return PreparedSpecimens(protocol)
    names = {section.name for section in named.values()}
    found = find_tracks(runs_dir, names, simulated=rig.kind == ONLY_SIMULATED)
    problems = find_too_many(next(iter(named)), found.tracks)
    warnings: list[Problem] = []
    for key, section in named.items():
        problem, is_doubt = _judge_age(f"{key}.specimen_file", section, now)
        if problem is not None:
            (warnings if is_doubt else problems).append(problem)
    for unread in found.unread:
        message = f"its tracks are not known, and may be crossed: {unread.message}"
        warnings.append(replace(unread, message=message))
    return PreparedSpecimens(protocol.put_tracks(found.tracks), tuple(problems), tuple(warnings))


def require_usable_specimens(
    protocol: ExperimentProtocol,
    rig: RigDescription | None,
    runs_dir: Path,
    now: datetime,
    say: Callable[[str], None],
) -> ExperimentProtocol:
    """Return a protocol as `prepare_specimens` does; say what is doubtful, and raise for what is wrong.

    `say` takes what is doubtful, line by line.

    Raises
    ------
    FileFormatError
        When a block cannot be used now.
    """
    prepared = prepare_specimens(protocol, rig, runs_dir, now)
    if prepared.problems:
        raise FileFormatError(prepared.problems)
    for warning in prepared.warnings:
        say(f"warning: {warning.where}: {warning.message}")
        if warning.hint:
            say(f"  hint: {warning.hint}")
    return prepared.protocol


def find_too_many(key: str, tracks: TracksBySpecimen) -> list[Problem]:
    """Return that the blocks have more tracks than a record keeps."""
    count = sum(map(len, tracks.values()))
    message = f"the specimens of this protocol have {count} tracks, and a record keeps {MOST_TRACKS}"
    problem = Problem(f"{key}.specimen_file", message, "take a fresh block, or make a run for each")
    return [problem] if count > MOST_TRACKS else []


def _judge_age(where: str, section: SpecimenSection, now: datetime) -> tuple[Problem | None, bool]:
    """Return what speaks against the use of a block now, and whether that is only doubtful."""
    age_h, until, cured_for_h = section.find_age_h(now), section.usable_until, section.cured_for_h
    name, now_is = f"specimen {section.name}", f"and now it is {now.isoformat(timespec='minutes')}"
    if age_h < 0:
        message = f"{name} was cast on {section.cast_on}, {now_is}"
        return Problem(where, message, "correct cast_on in its file, or the clock of this computer"), False
    if until is not None and datetime.fromisoformat(until) < now:
        hint = "take a fresh block, or set usable_until in its file to a later time"
        return Problem(where, f"{name} was usable until {until}, {now_is}", hint), False
    if cured_for_h is not None and age_h < cured_for_h:
        message = f"{name} is {age_h:.1f} h old, and cures for {cured_for_h:g} h by its file"
        return Problem(where, message, f"wait {cured_for_h - age_h:.1f} h more"), True
    return None, False


@dataclass(frozen=True)
class FoundTracks:
    """The tracks in each specimen, in order of time, and the runs whose tracks are not known, with the reason."""

    tracks: TracksBySpecimen
    unread: tuple[Problem, ...] = ()


def find_tracks(runs_dir: Path, names: Collection[str], *, simulated: bool) -> FoundTracks:
    """Return the tracks that the runs of a folder left in specimens.

    Parameters
    ----------
    names : collection of str
        The specimens.
    simulated : bool
        Whether the tracks of simulated runs are asked for, which are in no block of gel, or those of all other runs.

    Raises
    ------
    InputError
        When the folder cannot be read.
    """
    found: dict[str, list[SpecimenTrack]] = {name: [] for name in names}
    unread = []
    if found:
        condition = " or ".join(f'{BLOCK_NAME}="{name}"' for name in found)
        for path in [summary.run for summary in reversed(list_runs(runs_dir, condition))]:
            try:
                left = _list_tracks(path, simulated)
            except LabrigError as error:
                unread.append(Problem(str(path), error.message, error.hint))
                continue
            for name in found.keys() & left.keys():
                found[name] += left[name]
    return FoundTracks({name: tuple(tracks) for name, tracks in found.items()}, tuple(unread))


def _list_tracks(path: Path, simulated: bool) -> TracksBySpecimen:
    """Return the tracks that a run left in blocks with a specimen file, in order of time.

    Insertions that were broken off, or that a person had left out, have left a track too.
    """
    run = open_run(path)
    if is_simulated(run.manifest) != simulated:
        return {}
    protocol = load_run_protocol(run)
    blocks = {gel.name: gel.block for gel in protocol.gels.values() if gel.block is not None}
    sheath_mm = None if protocol.pictured_needle is None else protocol.pictured_needle.sheath_diameter_mm
    starts = run.read_events(SpecimenTrialStart) if blocks else ()
    return {
        name: tuple(
            SpecimenTrack(
                run=run.path.name,
                trial=start.trial,
                hole=start.hole,
                hole_position_mm=start.hole_position_mm,
                needle_id=start.needle_id,
                sheath_diameter_mm=sheath_mm,
                age_h=_find_age_h(run, block, start.t_s),
            )
            for start in starts
            if start.specimen == name
        )
        for name, block in blocks.items()
        if sheath_mm is not None
    }


def _find_age_h(run: Run, specimen: SpecimenFile, t_s: float) -> float:
    """Return the age of a specimen at a rig time of a run [h], rounded to seconds. Raises `RecordError`."""
    moment = run.find_moment(t_s)
    if moment is None:
        raise RecordError(f"{run.path} does not say when it began", COPY_HINT)
    return round(specimen.find_age_h(moment), 4)
