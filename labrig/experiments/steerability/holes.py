"""The holes of a sweep, in the order in which they are used, and where an insertion is made again."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from labrig.errors import InputError
from labrig.experiments.shared.holes import is_clear
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.protocol.sections import TrackedSpecimen
from labrig.runner.trials import Trial


@dataclass(frozen=True)
class Hole:
    """An entry point: its block of gel, its number of those of this run, and its place from the block's first [mm]."""

    specimen: TrackedSpecimen
    number: int
    position_mm: float


def list_holes(protocol: SteerabilityProtocol) -> tuple[Hole, ...]:
    """Return every hole of a sweep: specimen by specimen, the holes of each in the order asked for."""
    return tuple(
        Hole(specimen, hole, places_mm[hole])
        for index, specimen in enumerate(protocol.specimens)
        for places_mm in [protocol.list_places_mm(specimen)]
        for hole in _order_holes(protocol, index)
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


def describe_place(protocol: SteerabilityProtocol, number: int, hole: Hole, repeats: int | None) -> str:
    """Return where an insertion is: `hole 3 of 18`, in a random order `insertion 20, hole 7 of 18`."""
    of = f"of {protocol.insertions_per_specimen}" if repeats is None else f"in place of trial {repeats + 1}"
    place = f"hole {hole.number + 1} {of}"
    return place if protocol.hole_order == "sequential" else f"insertion {number + 1}, {place}"


def sort_holes(protocol: SteerabilityProtocol) -> Callable[[Trial[Hole]], tuple[int, float]]:
    """Return the key by which insertions are sorted: by block, then by place; in a random order repeats come last."""
    order = {specimen.name: place for place, specimen in enumerate(protocol.specimens)}
    sequential = protocol.hole_order == "sequential"
    return lambda trial: (
        order[trial.what.specimen.name],
        trial.what.position_mm if sequential else trial.number,
    )


def find_another_hole(protocol: SteerabilityProtocol, lost: Hole, used: Sequence[Hole]) -> Hole:
    """Return where an insertion is made again: beyond the last hole of its block, otherwise halfway between two.

    Raises
    ------
    InputError
        When the block has no room as far from the others and from old tracks as the protocol asks for.
    """
    own = [hole for hole in used if hole.specimen.name == lost.specimen.name]
    places_mm, gel = [hole.position_mm for hole in own], lost.specimen
    spacing_mm, diameter_mm = protocol.hole_spacing_mm, protocol.sheath.diameter_mm
    number, behind_mm = max(hole.number for hole in own) + 1, max(places_mm) + spacing_mm
    if behind_mm <= protocol.last_place_mm and is_clear(gel, behind_mm, diameter_mm):
        return Hole(gel, number, behind_mm)
    holes = range(protocol.insertions_per_specimen - 1)
    halfway_mm = [gel.first_hole_mm + (hole + 0.5) * spacing_mm for hole in holes]
    for place_mm in sorted(halfway_mm, key=lambda candidate_mm: abs(candidate_mm - lost.position_mm)):
        nearest_mm = min(abs(place_mm - other) for other in places_mm)
        if nearest_mm > protocol.needle.diameter_mm and is_clear(gel, place_mm, diameter_mm):
            return Hole(gel, number, place_mm)
    raise InputError(
        f"specimen {gel.name} has no room for another entry point, in which an insertion could be repeated: "
        f"{len(places_mm)} are used",
        "start a new run with a fresh block",
    )
