"""Requests to a person at the rig, which can be asked, answered and recorded.

A request is a subclass of `OperatorRequest`, and frozen. The record keeps its fields under the name of its class; a
person reads its `sentence`. An experiment of another package derives its own requests in the same way.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import ClassVar, Protocol, dataclass_transform


@dataclass_transform(frozen_default=True)
@dataclass(frozen=True)
class OperatorRequest:
    """Something that a person is asked to do or to confirm; `sentence` names its fields in braces.

    `brings_gel` says whether a specimen lies before the sheath after a yes; None: as before. Until that is said one is
    taken to lie there, so that needle and sheath count as in tissue when they move in.
    """

    sentence: ClassVar[str]
    brings_gel: ClassVar[bool | None] = None

    def __init_subclass__(cls) -> None:
        """Make a request a frozen dataclass."""
        dataclass(frozen=True)(cls)

    @property
    def text(self) -> str:
        """Return the request as a person reads it."""
        return self.sentence.format_map(vars(self))


class MountNeedle(OperatorRequest):
    """Mount the needle in the clamp."""

    sentence = "Mount needle {needle_id} in the clamp."

    needle_id: str


class ConfirmAxesAtZero(OperatorRequest):
    """Confirm that the axes stand where zero is to be."""

    sentence = (
        "Confirm that the axes stand at zero: the needle's tip flush with the end of the sheath, the "
        "bevel at roll zero, the sheath's end just before the gel, and no needle in tissue. Their "
        "positions become zero here."
    )


class PlaceSpecimen(OperatorRequest):
    """Put a specimen into the frame."""

    brings_gel = True
    sentence = "Place specimen {name} ({gelatin_percent:g} % gelatin) in the frame."

    name: str
    gelatin_percent: float


class ShiftToHole(OperatorRequest):
    """Shift the specimen so that a hole stands before the sheath; people count holes from one."""

    brings_gel = True

    specimen: str
    hole: int
    position_mm: float

    @property
    def text(self) -> str:
        """Return the request as a person reads it."""
        place = f"{self.position_mm:g} mm from its first entry point"
        return f"Shift specimen {self.specimen} to hole {self.hole + 1}, {place}."


class HoldBoard(OperatorRequest):
    """Hold the chessboard before the camera, in a pose that differs from the earlier ones; views count from one."""

    view: int
    views: int
    columns: int
    rows: int
    square_mm: float

    @property
    def text(self) -> str:
        """Return the request as a person reads it."""
        return (
            f"Hold the chessboard ({self.columns} x {self.rows} corners, {self.square_mm:g} mm squares) "
            f"still, tilted otherwise than before: view {self.view + 1} of {self.views}."
        )


class LayGraphPaper(OperatorRequest):
    """Lay graph paper into the steering plane."""

    sentence = (
        "Lay the graph paper ({pitch_mm:g} mm pitch) flat in the steering plane, its lines along the "
        "insertion."
    )

    pitch_mm: float


class PlacePhantom(OperatorRequest):
    """Put a block of gel with obstacles cast in into the frame, so that they are seen where the protocol says.

    obstacles : pixel (u, v) of the centre of each obstacle, and its radius [mm]. The camera is calibrated for pixels;
    coordinates of a frame would also have the error of how the graph paper was laid.
    """

    brings_gel = True

    name: str
    gelatin_percent: float
    obstacles: tuple[tuple[tuple[float, float], float], ...]

    @property
    def text(self) -> str:
        """Return the request as a person reads it."""
        seen = ", ".join(f"{radius:g} mm at ({u:.0f}, {v:.0f}) px" for (u, v), radius in self.obstacles)
        return (
            f"Place block {self.name} ({self.gelatin_percent:g} % gelatin) in the frame, where nothing has been "
            f"inserted yet; obstacles, by radius: {seen or 'none'}."
        )


class PickPixel(OperatorRequest):
    """Name a pixel of a picture; the answer has it."""

    picture: str


class PickTarget(PickPixel):
    """Name the target's pixel on a picture."""

    sentence = "Name the target's pixel on {picture}: u to the right, v down."


class PickMark(PickPixel):
    """Name the pixel of one of two marks that are a known length apart."""

    sentence = "Name the pixel of the {mark} of two marks on {picture} that are a known length apart."

    mark: str


class PickObstacle(PickPixel):
    """Name the pixel of an obstacle's centre on a picture; `asked` counts from 0 those that are asked for."""

    asked: int
    of: int
    radius_mm: float

    @property
    def text(self) -> str:
        """Return the request as a person reads it."""
        return (
            f"Name the pixel of the centre of an obstacle on {self.picture}, number {self.asked + 1} of {self.of}, "
            f"{self.radius_mm:g} mm in radius: u to the right, v down."
        )


class ConfirmPlan(OperatorRequest):
    """Look at the plan drawn into a picture, and let the needle go."""

    sentence = (
        "Look at {picture}: plan, obstacles and axes ({plan}). Confirm that the needle is to be inserted so."
    )

    picture: str
    target_px: tuple[float, float]
    plan: str


class ConfirmStopped(OperatorRequest):
    """Take note why the needle was stopped, and confirm that it may be withdrawn along its path."""

    sentence = "The needle was stopped: {reason}. Confirm that it may be withdrawn along its path."

    reason: str


class ClearBench(OperatorRequest):
    """Take something away."""

    brings_gel = False
    sentence = "Take away {what}."

    what: str


class ConfirmNeedleOut(OperatorRequest):
    """Confirm that no needle is in tissue, where the rig cannot know."""

    sentence = "Confirm that no needle is in tissue: {reason}. If one is: no, then labrig devices withdraw."

    reason: str


class WithdrawNeedle(OperatorRequest):
    """Let the drives withdraw a needle that an interrupted run left in tissue; may be declined."""

    sentence = (
        "Run {run} left its needle in tissue, up to {depth_mm:.1f} mm out of the sheath. Withdraw it "
        "with the drives, slowly, along the path that it took? No: take needle and sheath out by "
        "hand."
    )

    run: str
    depth_mm: float


class ConfirmUnchanged(OperatorRequest):
    """Confirm that nobody has changed anything since a run was interrupted; may be declined."""

    sentence = (
        "Run {run} goes on; the drives have kept their positions. Confirm that needle {needle_id} is clamped "
        "as it was, that nothing was moved by hand, and that specimen {specimen} is in the frame. No: each "
        "step is asked for again."
    )

    run: str
    needle_id: str
    specimen: str


class ConfirmHere(OperatorRequest):
    """Confirm that an axis stands where its position is to be set (homing method 35); nothing moves."""

    sentence = (
        "Confirm that the axis {axis} stands at its {position:g} {unit}: {place}. Nothing moves; its "
        "position becomes this here."
    )

    axis: str
    position: float
    unit: str
    place: str


class ConfirmMotion(OperatorRequest):
    """Confirm that an axis may move slowly, with a hand on the emergency stop."""

    sentence = (
        "The axis {axis} is going to {what}. Confirm that its way is free and that a hand is on the "
        "emergency stop."
    )

    axis: str
    what: str


class ConfirmFree(OperatorRequest):
    """Confirm that an axis stands free at one of its limits."""

    sentence = (
        "The axis {axis} stands at its limit, {position:g} {unit}. Confirm that it stands free of "
        "every stop, cable and frame."
    )

    axis: str
    position: float
    unit: str


class ReadLength(OperatorRequest):
    """Say how far apart two marks are; the answer has it."""

    sentence = "How many millimetres are the two marks apart?"


class ReadScale(OperatorRequest):
    """Read how far an axis has gone on graph paper, a ruler or a protractor; the answer is a number."""

    sentence = "{instruction} Type the reading of the axis {axis} in {unit}."

    axis: str
    unit: str
    instruction: str


class ConfirmFaultReset(OperatorRequest):
    """Confirm that the cause of a drive's fault is gone, so that it may be reset."""

    sentence = (
        "{fault}. What to do: {remedy}. Confirm that the cause is gone and the fault may be reset; "
        "nothing moves by that."
    )

    fault: str
    remedy: str


class ConfirmUnguarded(OperatorRequest):
    """Confirm the use of a drive of which nobody knows whether it stops when labrig ends."""

    sentence = (
        "The {drive}: {doubt}. Confirm that it was seen to stop by itself, without a needle, and may be used."
    )

    drive: str
    doubt: str


class ConfirmStance(OperatorRequest):
    """Confirm where the needle stands, where the drives have lost it."""

    run: str
    insertion_mm: float
    rotation_rad: float
    linear_mm: float
    lost: tuple[str, ...]

    @property
    def text(self) -> str:
        """Return the request as a person reads it."""
        return (
            f"The axes {', '.join(self.lost)} have lost their positions. At the end of run {self.run} the needle stood "
            f"{self.insertion_mm:.1f} mm out of the sheath, turned by {self.rotation_rad:.2f} rad, the sheath "
            f"{self.linear_mm:.1f} mm in. Look at needle and picture: confirm that they still stand so."
        )


class ConfirmWithdrawal(OperatorRequest):
    """Confirm that the needle may be withdrawn along its path."""

    moves: tuple[str, ...]

    @property
    def text(self) -> str:
        """Return the request as a person reads it."""
        return (
            f"The needle is going to be withdrawn slowly: {'; '.join(self.moves)}. Confirm it, with a hand on the "
            "emergency stop."
        )


class Paused(OperatorRequest):
    """The run is paused until the operator continues it."""

    sentence = "Paused {point}. The axes hold their positions and are supervised."

    point: str


def request_details(request: OperatorRequest, run: Path) -> dict[str, object]:
    """Return the fields of a request for a record; files of the run are relative to its folder."""
    return {
        key: value.removeprefix(f"{run}/") if isinstance(value, str) else value
        for key, value in asdict(request).items()
    }


class Choice(StrEnum):
    """What a person may choose instead of an answer."""

    PAUSE = "pause"
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
