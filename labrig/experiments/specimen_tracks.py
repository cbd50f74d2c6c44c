"""Finds the tracks that the runs of a folder have left in specimens."""

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from labrig.errors import LabrigError, Problem
from labrig.experiments.registry import load_run_protocol
from labrig.experiments.shared.holes import list_tracks
from labrig.protocol.specimen_file import SpecimenTrack, TracksBySpecimen
from labrig.record.catalogue import list_runs
from labrig.record.condition import BLOCK_NAME
from labrig.record.layout import is_simulated
from labrig.record.reader import open_run


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
    run = open_run(path)
    return list_tracks(run, load_run_protocol(run)) if is_simulated(run.manifest) == simulated else {}
