"""What a person does at the rig, as requests that can be asked, answered and recorded."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class MountNeedle:
    """Mount the needle in the clamp."""

    needle_id: str

    @property
    def text(self) -> str:
        """Return the request as a sentence."""
        return f"Mount needle {self.needle_id} in the clamp."


@dataclass(frozen=True)
class ConfirmAxesAtZero:
    """Confirm that the axes stand where zero is to be."""

    @property
    def text(self) -> str:
        """Return the request as a sentence."""
        return (
            "Confirm that the axes stand at zero: the needle's tip flush with the end of the sheath, the "
            "bevel at roll zero, the sheath's end just before the gel, and no needle in tissue. Their "
            "positions become zero here."
        )


@dataclass(frozen=True)
class PlaceSpecimen:
    """Put a specimen into the frame."""

    name: str
    gelatin_percent: float

    @property
    def text(self) -> str:
        """Return the request as a sentence."""
        return f"Place specimen {self.name} ({self.gelatin_percent:g} % gelatin) in the frame."


@dataclass(frozen=True)
class ShiftToHole:
    """Shift the specimen so that a hole stands before the sheath."""

    specimen: str
    hole: int
    position_mm: float

    @property
    def text(self) -> str:
        """Return the request as a sentence; people count holes from one."""
        return (
            f"Shift specimen {self.specimen} to hole {self.hole + 1}, {self.position_mm:g} mm from the first."
        )


@dataclass(frozen=True)
class HoldBoard:
    """Hold the chessboard before the camera, in a pose that differs from the earlier ones."""

    view: int
    views: int
    columns: int
    rows: int
    square_mm: float

    @property
    def text(self) -> str:
        """Return the request as a sentence; people count views from one."""
        return (
            f"Hold the chessboard ({self.columns} x {self.rows} corners, {self.square_mm:g} mm squares) "
            f"still, tilted otherwise than before: view {self.view + 1} of {self.views}."
        )


@dataclass(frozen=True)
class LayGraphPaper:
    """Lay graph paper into the steering plane."""

    pitch_mm: float

    @property
    def text(self) -> str:
        """Return the request as a sentence."""
        return (
            f"Lay the graph paper ({self.pitch_mm:g} mm pitch) flat in the steering plane, "
            "its lines along the insertion."
        )


@dataclass(frozen=True)
class ClearBench:
    """Take something away."""

    what: str

    @property
    def text(self) -> str:
        """Return the request as a sentence."""
        return f"Take away {self.what}."


@dataclass(frozen=True)
class ConfirmNeedleOut:
    """Confirm that no needle is in tissue, where the rig cannot know."""

    reason: str

    @property
    def text(self) -> str:
        """Return the request as a sentence."""
        return f"Confirm that no needle is in tissue: {self.reason}."


@dataclass(frozen=True)
class WithdrawNeedle:
    """Let the drives withdraw a needle that an interrupted run left in tissue; may be declined."""

    run: str
    depth_mm: float

    @property
    def text(self) -> str:
        """Return the request as a sentence."""
        return (
            f"Run {self.run} left its needle in tissue, up to {self.depth_mm:.1f} mm out of the sheath. "
            "Withdraw it with the drives, slowly, along the path that it took? "
            "No: take needle and sheath out by hand."
        )


OperatorRequest = (
    MountNeedle
    | ConfirmAxesAtZero
    | PlaceSpecimen
    | ShiftToHole
    | HoldBoard
    | LayGraphPaper
    | ClearBench
    | ConfirmNeedleOut
    | WithdrawNeedle
)


@dataclass(frozen=True)
class Answer:
    """What the operator said: done or refused, and a note for the record."""

    confirmed: bool
    note: str = ""


class Operator(Protocol):
    """Whoever does what the rig cannot do by itself."""

    def ask(self, request: OperatorRequest, meanwhile: Callable[[], None]) -> Answer:
        """Ask, wait until it is done or refused, and return the answer.

        Whoever has to wait calls `meanwhile` ten times a second or more: the drives hear the computer by it.
        """
        ...
