"""Requests to a person at the rig, which can be asked, answered and recorded.

A request is a subclass of `OperatorRequest`, and frozen. The record keeps its fields under the name of its class; a
person reads its docstring. An experiment of another package derives its own requests in the same way.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import ClassVar, Protocol, dataclass_transform


@dataclass_transform(frozen_default=True)
@dataclass(frozen=True)
class OperatorRequest:
    """Something that a person is asked to do or to confirm; the docstring of a request is its sentence.

    `brings_gel` says whether a specimen lies before the sheath after a yes; None: as before. Until that is said one is
    taken to lie there, so that needle and sheath count as in tissue when they move in.
    """

    brings_gel: ClassVar[bool | None] = None

    def __init_subclass__(cls) -> None:
        """Make a request a frozen dataclass."""
        dataclass(frozen=True)(cls)

    @property
    def text(self) -> str:
        """Return the request as a person reads it: its docstring, with its fields in the braces."""
        return " ".join(str(self.__doc__).split()).format_map(vars(self) | self.more())

    def more(self) -> dict[str, object]:
        """Return what the braces name besides its fields."""
        return {}


class MountNeedle(OperatorRequest):
    """Mount needle {needle_id} in the clamp; leave it if it is there."""

    needle_id: str


class ConfirmAxesAtZero(OperatorRequest):
    """Confirm that the axes stand at zero, and no needle is in tissue.

    The needle's tip is flush with the end of the sheath, which is just before the gel's place. The bevel is turned,
    by eye, so that the needle bends towards -y. These positions become zero.
    """


class PlaceSpecimen(OperatorRequest):
    """Place specimen {name} ({gelatin_percent:g} % gelatin) in the frame."""

    brings_gel = True

    name: str
    gelatin_percent: float


class ShiftToHole(OperatorRequest):
    """Shift specimen {specimen} to hole {number}, {position_mm:g} mm from its first entry point.

    Nothing may have been inserted there yet.
    """

    brings_gel = True

    specimen: str
    hole: int
    position_mm: float

    def more(self) -> dict[str, object]:
        """Return the number of the hole; people count from one."""
        return {"number": self.hole + 1}


class HoldBoard(OperatorRequest):
    """Hold the chessboard ({columns} x {rows} corners, {square_mm:g} mm squares) still: view {number} of {views}.

    Tilt it otherwise for each view.
    """

    view: int
    views: int
    columns: int
    rows: int
    square_mm: float

    def more(self) -> dict[str, object]:
        """Return the number of the view; people count from one."""
        return {"number": self.view + 1}


class LayGraphPaper(OperatorRequest):
    """Lay the graph paper ({pitch_mm:g} mm pitch) flat in the steering plane, its lines along the insertion."""

    pitch_mm: float


class PlacePhantom(OperatorRequest):
    """Place block {name} ({gelatin_percent:g} % gelatin) in the frame, where nothing has been inserted yet.

    Obstacles, by radius: {seen}.
    """

    brings_gel = True

    name: str
    gelatin_percent: float
    obstacles: tuple[tuple[tuple[float, float], float], ...]
    """Pixel (u, v) of the centre of each, and its radius [mm]. The camera is calibrated for pixels; coordinates of a
    frame would also have the error of how the graph paper was laid."""

    def more(self) -> dict[str, object]:
        """Return where the obstacles are seen."""
        seen = (f"{radius:g} mm at ({u:.0f}, {v:.0f}) px" for (u, v), radius in self.obstacles)
        return {"seen": ", ".join(seen) or "none"}


class PickPixel(OperatorRequest):
    """Name a pixel of {picture}: u to the right, v down."""

    picture: str


class PickTarget(PickPixel):
    """Name the target's pixel on {picture}: u to the right, v down."""


class PickMark(PickPixel):
    """Name the pixel of the {mark} of two marks on {picture} that are a known length apart."""

    mark: str


class PickObstacle(PickPixel):
    """Name the pixel of an obstacle's centre on {picture}: u to the right, v down.

    It is number {number} of {of}, {radius_mm:g} mm in radius.
    """

    asked: int
    of: int
    radius_mm: float

    def more(self) -> dict[str, object]:
        """Return its number among those that are asked for; people count from one."""
        return {"number": self.asked + 1}


class ConfirmPlan(OperatorRequest):
    """Look at {picture}: plan, obstacles and axes ({plan}). Confirm that the needle is to be inserted so."""

    picture: str
    target_px: tuple[float, float]
    plan: str


class ConfirmStopped(OperatorRequest):
    """The needle was stopped: {reason}. Confirm that it may be withdrawn along its path."""

    reason: str


class ClearBench(OperatorRequest):
    """Take away {what}."""

    brings_gel = False

    what: str


class ConfirmNeedleOut(OperatorRequest):
    """Confirm that no needle is in tissue: {reason}. If one is: no, then labrig devices withdraw."""

    reason: str


class WithdrawNeedle(OperatorRequest):
    """Run {run} left its needle in tissue, up to {depth_mm:.1f} mm out of the sheath.

    Withdraw it with the drives, slowly, along the path that it took? No: take needle and sheath out by hand.
    """

    run: str
    depth_mm: float


class ConfirmUnchanged(OperatorRequest):
    """Run {run} goes on; the drives have kept their positions.

    Confirm that needle {needle_id} is clamped as it was, that nothing was moved by hand, and that specimen {specimen}
    is in the frame. No: each step is asked for again.
    """

    run: str
    needle_id: str
    specimen: str


class ConfirmHere(OperatorRequest):
    """Confirm that the axis {axis} stands at its {position:g} {unit}: {place}.

    Nothing moves; its position becomes this here.
    """

    axis: str
    position: float
    unit: str
    place: str


class ConfirmMotion(OperatorRequest):
    """The axis {axis} is going to {what}.

    Confirm that its way is free and that a hand is on the emergency stop.
    """

    axis: str
    what: str


class ReadLength(OperatorRequest):
    """Type how many millimetres the two marks are apart."""


class ConfirmFaultReset(OperatorRequest):
    """{fault}. What to do: {remedy}.

    Confirm that the cause is gone and the fault may be reset; nothing moves by that.
    """

    fault: str
    remedy: str


class ConfirmUnguarded(OperatorRequest):
    """The {drive}: {doubt}. Confirm that it was seen to stop by itself, without a needle, and may be used."""

    drive: str
    doubt: str


class ConfirmStance(OperatorRequest):
    """The axes {names} have lost their positions. Look at needle and picture: confirm that they still stand so.

    At the end of run {run} the needle stood {insertion_mm:.1f} mm out of the sheath, turned by {rotation_rad:.2f} rad,
    the sheath {linear_mm:.1f} mm in.
    """

    run: str
    insertion_mm: float
    rotation_rad: float
    linear_mm: float
    lost: tuple[str, ...]

    def more(self) -> dict[str, object]:
        """Return the names of the axes that are lost."""
        return {"names": ", ".join(self.lost)}


class ConfirmWithdrawal(OperatorRequest):
    """The needle is going to be withdrawn slowly: {way}. Confirm it, with a hand on the emergency stop."""

    moves: tuple[str, ...]

    def more(self) -> dict[str, object]:
        """Return its moves."""
        return {"way": "; ".join(self.moves)}


class Paused(OperatorRequest):
    """Paused {point}. The axes hold their positions and are supervised."""

    point: str


def request_details(request: OperatorRequest, run: Path) -> dict[str, object]:
    """Return the fields of a request for a record; files of the run are relative to its folder."""
    return {
        key: value.removeprefix(f"{run}/") if isinstance(value, str) else value
        for key, value in asdict(request).items()
    }


class Choice(StrEnum):
    """What a person may choose instead of an answer."""

    REPEAT = "repeat"
    SKIP = "skip"
    MARK_BAD = "mark_bad"
    NOTE = "note"
    UNDO = "undo"


@dataclass(frozen=True)
class Offer:
    """What a person may choose instead of an answer, and a line that says where the run is."""

    choices: tuple[Choice, ...] = ()
    status: str = ""


NO_OFFER = Offer()
"""There is nothing to choose."""


@dataclass(frozen=True)
class Answer:
    """Answer of the operator: done or refused, a note for the record, and a requested reading or pixel.

    With a `choice` nothing was answered; `note` then is the text of a note, or why a trial is bad.
    """

    confirmed: bool
    note: str = ""
    reading: float | None = None
    pixel: tuple[float, float] | None = None
    choice: Choice | None = None


class Operator(Protocol):
    """A person, or a substitute, who does what the rig cannot do by itself."""

    def ask(self, request: OperatorRequest, meanwhile: Callable[[], None], offer: Offer = NO_OFFER) -> Answer:
        """Ask, wait until it is done or refused or something on offer was chosen, and return the answer.

        While it waits, it calls `meanwhile` at least ten times a second, which sends the heartbeats. An operator that
        is no person chooses nothing.
        """
