"""The insertions of a sweep in order, and the remaining ones of an interrupted sweep."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from labrig.errors import InputError
from labrig.experiments.shared.holes import is_clear
from labrig.experiments.steerability.events import SweepTrialStart, SweepTrialStop
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.protocol.sections import TrackedSpecimen
from labrig.record.decisions import NO_DECISIONS, Decisions
from labrig.record.events import RecordedTrial, Repeat
from labrig.text import ordinal

_MOST_TOLD = 30
"""Holes of a block whose order is told in a sentence."""


@dataclass(frozen=True)
class PlannedTrial:
    """One insertion of a sweep.

    Attributes
    ----------
    trial : int
        Its number, unique in a run.
    specimen : TrackedSpecimen
        The block of gel.
    hole : int
        Number of the entry point in that block, of those of this run.
    hole_position_mm : float
        Its distance from the first entry point that the block ever had.
    repeats : int or None
        The trial that it replaces: one that was interrupted, or that a person has made again.
    """

    trial: int
    specimen: TrackedSpecimen
    hole: int
    hole_position_mm: float
    repeats: int | None = None


BegunTrial: TypeAlias = RecordedTrial[SweepTrialStart, SweepTrialStop]
"""A recorded insertion: its entry point, and whether it was completed."""


def list_planned_trials(protocol: SteerabilityProtocol) -> tuple[PlannedTrial, ...]:
    """Return every insertion of a sweep in order: specimen by specimen, the holes of each in the order asked for."""
    holes = protocol.insertions_per_specimen
    return tuple(
        PlannedTrial(index * holes + made, specimen, hole, places_mm[hole])
        for index, specimen in enumerate(protocol.specimens)
        for places_mm in [protocol.list_places_mm(specimen)]
        for made, hole in enumerate(_order_holes(protocol, index))
    )


def _order_holes(protocol: SteerabilityProtocol, block: int) -> tuple[int, ...]:
    """Return the holes of a block in the order in which they are used; `block` is its place among the specimens.

    A random order sorts them by raw numbers of NumPy's PCG64, seeded with the protocol's seed and the block. NumPy
    keeps these the same in every version, unlike the permutations of its Generator: a record replays with a later one.
    """
    holes = range(protocol.insertions_per_specimen)
    if protocol.hole_order == "sequential":
        return tuple(holes)
    keys = np.random.PCG64([protocol.seed, block]).random_raw(len(holes))
    return tuple(np.argsort(keys, kind="stable").tolist())


def describe_order(protocol: SteerabilityProtocol) -> Iterator[str]:
    """Yield a sentence for each block whose holes are used in a random order; people count holes from one."""
    for index, specimen in enumerate(protocol.specimens) if protocol.hole_order == "random" else ():
        holes = [str(hole + 1) for hole in _order_holes(protocol, index)]
        more = f" and {len(holes) - _MOST_TOLD} more" if len(holes) > _MOST_TOLD else ""
        yield f"holes of {specimen.name}, in this order: {', '.join(holes[:_MOST_TOLD])}{more}"


def describe_place(protocol: SteerabilityProtocol, trial: PlannedTrial) -> str:
    """Return where an insertion is among those of its block: `hole 3 of 18`, in a random order `hole 7 (3rd of 18)`."""
    holes, hole = protocol.insertions_per_specimen, trial.hole + 1
    if protocol.hole_order == "sequential":
        return f"hole {hole} of {holes}"
    if trial.repeats is not None:
        return f"hole {hole} (repeats trial {trial.repeats})"
    return f"hole {hole} ({ordinal(trial.trial % holes + 1)} of {holes})"


def list_remaining_trials(
    protocol: SteerabilityProtocol, begun: Sequence[BegunTrial], decisions: Decisions = NO_DECISIONS
) -> tuple[PlannedTrial, ...]:
    """Return the rest of a sweep: trials not yet begun, and each trial that is made again at another entry point.

    Trials that a person has skipped are left out. A trial that was interrupted, or that a person has made again, is
    repeated beyond the last hole of its block if the block has room for the arc, otherwise
    halfway between two holes. Trials not yet begun keep number, hole and place. Within a block the next one is the
    nearest to the first hole; in a random order, the repeated ones come last.

    Raises
    ------
    InputError
        When a block has no room for another entry point.
    """
    numbers = {trial.start.trial for trial in begun} | {skip.trial for skip in decisions.skipped}
    left = [trial for trial in list_planned_trials(protocol) if trial.trial not in numbers]
    left += _plan_repeats(protocol, begun, decisions)
    order = {specimen.name: place for place, specimen in enumerate(protocol.specimens)}
    sequential = protocol.hole_order == "sequential"
    return tuple(
        sorted(
            left,
            key=lambda trial: (
                order[trial.specimen.name],
                trial.hole_position_mm if sequential else trial.trial,
            ),
        )
    )


def can_repeat(
    protocol: SteerabilityProtocol, begun: Sequence[BegunTrial], decisions: Decisions, trial: int
) -> bool:
    """Return whether the block of a trial has room for another entry point in which to make it again."""
    try:
        list_remaining_trials(protocol, begun, decisions.add(Repeat(trial=trial)))
    except InputError:
        return False
    return True


def _plan_repeats(
    protocol: SteerabilityProtocol, begun: Sequence[BegunTrial], decisions: Decisions
) -> Iterator[PlannedTrial]:
    starts = [trial.start for trial in begun]
    repeated = {start.repeats for start in starts} | {skip.repeats for skip in decisions.skipped}
    specimens = {specimen.name: specimen for specimen in protocol.specimens}
    planned = list_planned_trials(protocol)
    used = [(trial.specimen.name, trial.hole, trial.hole_position_mm) for trial in planned]
    used += [
        (start.specimen, start.hole, start.hole_position_mm) for start in starts if start.repeats is not None
    ]
    skipped = (skip.trial for skip in decisions.skipped)
    number = max([len(planned) - 1, *(start.trial for start in starts), *skipped]) + 1
    for lost in [trial.start for trial in begun if _is_made_again(trial, decisions)]:
        if lost.trial in repeated:
            continue
        holes = [hole for name, hole, _ in used if name == lost.specimen]
        places_mm = [place_mm for name, _, place_mm in used if name == lost.specimen]
        place_mm = _find_free_place_mm(protocol, specimens[lost.specimen], lost, places_mm)
        again = PlannedTrial(number, specimens[lost.specimen], max(holes) + 1, place_mm, lost.trial)
        used.append((lost.specimen, again.hole, place_mm))
        number += 1
        yield again


def _is_made_again(trial: BegunTrial, decisions: Decisions) -> bool:
    return trial.exit_status != "success" or trial.start.trial in decisions.repeated


def _find_free_place_mm(
    protocol: SteerabilityProtocol, gel: TrackedSpecimen, lost: SweepTrialStart, places_mm: Sequence[float]
) -> float:
    """Return a free entry point of a block, as far from the others and from old tracks as the protocol requires."""
    spacing_mm, diameter_mm = protocol.hole_spacing_mm, protocol.sheath.diameter_mm
    behind_mm = max(places_mm) + spacing_mm
    if behind_mm <= protocol.last_place_mm and is_clear(gel, behind_mm, diameter_mm):
        return behind_mm
    holes = range(protocol.insertions_per_specimen - 1)
    halfway_mm = [gel.first_hole_mm + (hole + 0.5) * spacing_mm for hole in holes]
    for place_mm in sorted(halfway_mm, key=lambda candidate_mm: abs(candidate_mm - lost.hole_position_mm)):
        nearest_mm = min(abs(place_mm - other) for other in places_mm)
        if nearest_mm > protocol.needle.diameter_mm and is_clear(gel, place_mm, diameter_mm):
            return place_mm
    raise InputError(
        f"specimen {lost.specimen} has no room for another entry point, in which trial {lost.trial} "
        f"could be repeated: {len(places_mm)} are used",
        "start a new run with a fresh block",
    )
