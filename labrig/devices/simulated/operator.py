"""The simulated operator: does to the world what a person does at the bench, and always agrees."""

from collections.abc import Callable
from dataclasses import dataclass

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
    ShiftToHole,
)
from labrig.simulation.gel import Ball
from labrig.simulation.world import World

_WHO = "simulated operator"


@dataclass(frozen=True)
class SimulatedOperator:
    """Moves the world.

    Parameters
    ----------
    world : World
        What it moves.
    """

    world: World

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
        pixel = None
        match request:
            case PickTarget():
                pixel = self.world.target_mark_px()
            case PickObstacle(_, asked):
                pixel = self.world.obstacle_mark_px(asked)
            case _:
                self._act(request)
        return Answer(confirmed=True, note=_WHO, pixel=pixel)

    def _act(self, request: OperatorRequest) -> None:
        """Do what is asked; a confirmation is always true: the world is new, and the axes are at zero."""
        world = self.world
        match request:
            case MountNeedle(needle_id):
                world.mount_needle(needle_id)
            case PlaceSpecimen(name, gelatin_percent):
                world.place_specimen(name, gelatin_percent)
            case ShiftToHole(specimen, hole, position_mm):
                world.shift_to_hole(specimen, hole, position_mm)
            case PlacePhantom(name, gelatin_percent, obstacles):
                balls = [Ball(world.point_at_pixel_mm(pixel), radius_mm) for pixel, radius_mm in obstacles]
                world.place_phantom(name, gelatin_percent, balls)
            case ConfirmPlan(_, target_px):
                world.aim_at(world.point_at_pixel_mm(target_px))
            case HoldBoard(view, _, columns, rows, square_mm):
                world.hold_board(view, columns, rows, square_mm)
            case LayGraphPaper(pitch_mm):
                world.lay_graph_paper(pitch_mm)
            case ClearBench():
                world.clear_bench()


@dataclass(frozen=True)
class RehearsedOperator:
    """A person answers as at a bench; what their hands would have done there is done in the world.

    Parameters
    ----------
    person : Operator
        Who answers.
    hands : SimulatedOperator
        Does what the person has confirmed.
    """

    person: Operator
    hands: SimulatedOperator

    def ask(self, request: OperatorRequest, meanwhile: Callable[[], None], offer: Offer = NO_OFFER) -> Answer:
        """Ask the person, and do what is confirmed. Raises what the two raise."""
        answer = self.person.ask(request, meanwhile, offer)
        if answer.confirmed:
            self.hands.ask(request, meanwhile)
        return answer
