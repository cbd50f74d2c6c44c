"""The specimens of a protocol before a run: the tracks that are in them, and whether they are of an age to be used."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from labrig.devices.can_description import ONLY_SIMULATED
from labrig.devices.rig_file import RigDescription
from labrig.errors import FileFormatError, Problem
from labrig.experiments.specimen_tracks import find_tracks
from labrig.protocol.sections import ExperimentProtocol
from labrig.protocol.specimen_file import MOST_TRACKS, SpecimenSection, TracksBySpecimen


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
    return PreparedSpecimens(
        protocol.put_tracks(found.tracks),
        (
            *(problem for key, section in named.items() for problem in _find_age_problems(key, section, now)),
            *find_too_many(next(iter(named)), found.tracks),
        ),
        (
            *(problem for key, section in named.items() for problem in _warn_of_age(key, section, now)),
            *(_warn_of_unread(problem) for problem in found.unread),
        ),
    )


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


def _find_age_problems(key: str, section: SpecimenSection, now: datetime) -> list[Problem]:
    """Return why a block cannot be used now: it is not cast yet, or its time is over."""
    where, moment = f"{key}.specimen_file", now.isoformat(timespec="minutes")
    if section.find_age_h(now) < 0:
        message = f"specimen {section.name} was cast on {section.cast_on}, and now it is {moment}"
        return [Problem(where, message, "correct cast_on in its file, or the clock of this computer")]
    if section.usable_until is not None and datetime.fromisoformat(section.usable_until) < now:
        message = f"specimen {section.name} was usable until {section.usable_until}, and now it is {moment}"
        return [
            Problem(where, message, "take a fresh block, or set usable_until in its file to a later time")
        ]
    return []


def find_too_many(key: str, tracks: TracksBySpecimen) -> list[Problem]:
    """Return that the blocks have more tracks than a record keeps."""
    count = sum(map(len, tracks.values()))
    if count <= MOST_TRACKS:
        return []
    message = f"the specimens of this protocol have {count} tracks, and a record keeps {MOST_TRACKS}"
    return [Problem(f"{key}.specimen_file", message, "take a fresh block, or make a run for each")]


def _warn_of_age(key: str, section: SpecimenSection, now: datetime) -> list[Problem]:
    """Return that a block has not cured for as long as its file says."""
    age_h, cured_for_h = section.find_age_h(now), section.cured_for_h
    if cured_for_h is None or not 0 <= age_h < cured_for_h:
        return []
    message = f"specimen {section.name} is {age_h:.1f} h old, and cures for {cured_for_h:g} h by its file"
    return [Problem(f"{key}.specimen_file", message, f"wait {cured_for_h - age_h:.1f} h more")]


def _warn_of_unread(problem: Problem) -> Problem:
    message = f"its tracks are not known, and may be crossed: {problem.message}"
    return Problem(problem.where, message, problem.hint)
