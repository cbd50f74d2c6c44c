"""The simulated operator: does to the world what a person would do to the bench, and always says yes."""

import math
from collections.abc import Callable, Mapping

from labrig.devices.operator import (
    Answer,
    ClearBench,
    ConfirmPlan,
    HoldBoard,
    LayGraphPaper,
    MountNeedle,
    OperatorRequest,
    PickTarget,
    PlacePhantom,
    PlaceSpecimen,
    ReadScale,
    ShiftToHole,
)
from labrig.simulation.gel import Ball
from labrig.simulation.world import World

_WHO = "simulated operator"


class SimulatedOperator:
    """Moves the world.

    Parameters
    ----------
    world : World
        What it moves.
    where : callable
        Returns where each axis truly stands [mm or rad], as a scale beside it would show.
    """

    def __init__(self, world: World, where: Callable[[], Mapping[str, float]]) -> None:
        self._world = world
        self._where = where

    def ask(self, request: OperatorRequest, meanwhile: Callable[[], None]) -> Answer:  # noqa: ARG002 - never waits
        """Do what is asked.

        Raises
        ------
        InputError
            When the world cannot be moved so, such as a gel shifted with a needle in it.
        """
        return self._answered(request) or self._done(request)

    def _answered(self, request: OperatorRequest) -> Answer | None:
        """Return the answer to what is asked for a number or a place; None to anything else."""
        match request:
            case PickTarget():
                return Answer(confirmed=True, note=_WHO, pixel=self._world.target_mark_px())
            case ReadScale(axis, unit):
                truly = self._where()[axis]
                return Answer(
                    confirmed=True, note=_WHO, reading=math.degrees(truly) if unit == "deg" else truly
                )
        return None

    def _done(self, request: OperatorRequest) -> Answer:
        match request:
            case MountNeedle(needle_id):
                self._world.mount_needle(needle_id)
            case PlaceSpecimen(name, gelatin_percent):
                self._world.place_specimen(name, gelatin_percent)
            case ShiftToHole(specimen, hole, position_mm):
                self._world.shift_to_hole(specimen, hole, position_mm)
            case PlacePhantom(name, gelatin_percent, obstacles):
                balls = [Ball(self._world.seen_at_mm(pixel), radius_mm) for pixel, radius_mm in obstacles]
                self._world.place_phantom(name, gelatin_percent, balls)
            case ConfirmPlan(_, target_px):
                self._world.aim_at(self._world.seen_at_mm(target_px))
            case HoldBoard(view, _, columns, rows, square_mm):
                self._world.hold_board(view, columns, rows, square_mm)
            case LayGraphPaper(pitch_mm):
                self._world.lay_graph_paper(pitch_mm)
            case ClearBench():
                self._world.clear_bench()
            case _:
                pass  # what a person only confirms is so here: the world is new, and the axes stand at zero
        return Answer(confirmed=True, note=_WHO)
