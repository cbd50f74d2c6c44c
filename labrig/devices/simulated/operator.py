"""The simulated operator: does to the world what a person does at the bench, and always agrees."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

from labrig.devices.operator import (
    NO_OFFER,
    Answer,
    ClearBench,
    ConfirmPlan,
    HoldBoard,
    LayGraphPaper,
    MountNeedle,
    Offer,
    Operator,
    OperatorRequest,
    PickObstacle,
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
    true_positions : callable
        Returns the true position of each axis [mm or rad], as a scale beside it would show.
    """

    def __init__(self, world: World, true_positions: Callable[[], Mapping[str, float]]) -> None:
        self._world = world
        self._true_positions = true_positions

    def ask(
        self,
        request: OperatorRequest,
        meanwhile: Callable[[], None],  # noqa: ARG002 - never waits
        offer: Offer = NO_OFFER,  # noqa: ARG002 - chooses nothing
    ) -> Answer:
        """Do what is asked.

        Raises
        ------
        InputError
            When the world cannot do this, such as shifting a gel with a needle in it.
        """
        return self._answer(request) or self._act(request)

    def _answer(self, request: OperatorRequest) -> Answer | None:
        """Return the answer to a request for a number or a pixel; None for other requests."""
        match request:
            case PickTarget():
                return Answer(confirmed=True, note=_WHO, pixel=self._world.target_mark_px())
            case PickObstacle(_, asked):
                return Answer(confirmed=True, note=_WHO, pixel=self._world.obstacle_mark_px(asked))
            case ReadScale(axis, unit):
                truly = self._true_positions()[axis]
                return Answer(
                    confirmed=True, note=_WHO, reading=math.degrees(truly) if unit == "deg" else truly
                )
        return None

    def _act(self, request: OperatorRequest) -> Answer:
        match request:
            case MountNeedle(needle_id):
                self._world.mount_needle(needle_id)
            case PlaceSpecimen(name, gelatin_percent):
                self._world.place_specimen(name, gelatin_percent)
            case ShiftToHole(specimen, hole, position_mm):
                self._world.shift_to_hole(specimen, hole, position_mm)
            case PlacePhantom(name, gelatin_percent, obstacles):
                balls = [
                    Ball(self._world.point_at_pixel_mm(pixel), radius_mm) for pixel, radius_mm in obstacles
                ]
                self._world.place_phantom(name, gelatin_percent, balls)
            case ConfirmPlan(_, target_px):
                self._world.aim_at(self._world.point_at_pixel_mm(target_px))
            case HoldBoard(view, _, columns, rows, square_mm):
                self._world.hold_board(view, columns, rows, square_mm)
            case LayGraphPaper(pitch_mm):
                self._world.lay_graph_paper(pitch_mm)
            case ClearBench():
                self._world.clear_bench()
            case _:
                pass  # a confirmation is always true here: the world is new, and the axes are at zero
        return Answer(confirmed=True, note=_WHO)


class RehearsedOperator:
    """A person answers as at a bench; what their hands would have done there is done in the world.

    Parameters
    ----------
    person : Operator
        Who answers.
    hands : SimulatedOperator
        Does what the person has confirmed, and reads the scales that the person cannot see.
    """

    def __init__(self, person: Operator, hands: SimulatedOperator) -> None:
        self._person = person
        self._hands = hands

    def ask(self, request: OperatorRequest, meanwhile: Callable[[], None], offer: Offer = NO_OFFER) -> Answer:
        """Ask the person, and do what is confirmed. Raises what the two raise."""
        if isinstance(request, ReadScale):
            shown = self._hands.ask(request, meanwhile).reading
            request = replace(
                request, instruction=f"{request.instruction} It is simulated and shows {shown:.3f}."
            )
        answer = self._person.ask(request, meanwhile, offer)
        if answer.confirmed:
            self._hands.ask(request, meanwhile)
        return answer
