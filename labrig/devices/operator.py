"""What a person does at the rig, as requests that can be asked, answered and recorded."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
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
class PlacePhantom:
    """Put a block of gel with obstacles cast in into the frame, so that they are seen where the protocol says.

    obstacles : the pixel (u, v) of each one's centre, and its radius [mm]. What the camera is calibrated for is where
    things are seen; a frame that nobody sees would be off by how the graph paper was laid.
    """

    name: str
    gelatin_percent: float
    obstacles: tuple[tuple[tuple[float, float], float], ...]

    @property
    def text(self) -> str:
        """Return the request as a sentence."""
        seen = ", ".join(f"{radius:g} mm at ({u:.0f}, {v:.0f}) px" for (u, v), radius in self.obstacles)
        return (
            f"Place block {self.name} ({self.gelatin_percent:g} % gelatin) in the frame, where nothing has been "
            f"inserted yet; obstacles, by radius: {seen or 'none'}."
        )


@dataclass(frozen=True)
class PickTarget:
    """Name the target's pixel on a picture."""

    picture: str

    @property
    def text(self) -> str:
        """Return the request as a sentence."""
        return f"Name the target's pixel on {self.picture}: u to the right, v down."


@dataclass(frozen=True)
class ConfirmPlan:
    """Look at the plan drawn into a picture, and let the needle go."""

    picture: str
    target_px: tuple[float, float]
    plan: str

    @property
    def text(self) -> str:
        """Return the request as a sentence."""
        return (
            f"Look at {self.picture}: plan, obstacles and axes ({self.plan}). Confirm that the needle is to be "
            "inserted so."
        )


@dataclass(frozen=True)
class ConfirmStopped:
    """Take note why the needle was stopped, and confirm that it may be withdrawn along its path."""

    reason: str

    @property
    def text(self) -> str:
        """Return the request as a sentence."""
        return f"The needle was stopped: {self.reason}. Confirm that it may be withdrawn along its path."


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
        return f"Confirm that no needle is in tissue: {self.reason}. If one is: no, then labrig devices withdraw."


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


@dataclass(frozen=True)
class ConfirmHere:
    """Confirm that an axis stands where its position is to be set (homing method 35); nothing moves."""

    axis: str
    position: float
    unit: str
    place: str

    @property
    def text(self) -> str:
        """Return the request as a sentence."""
        return (
            f"Confirm that the axis {self.axis} stands at its {self.position:g} {self.unit}: {self.place}. "
            "Nothing moves; its position becomes this here."
        )


@dataclass(frozen=True)
class ConfirmMotion:
    """Confirm that an axis may move slowly, with a hand on the emergency stop."""

    axis: str
    what: str

    @property
    def text(self) -> str:
        """Return the request as a sentence."""
        return (
            f"The axis {self.axis} is going to {self.what}. Confirm that its way is free and that a hand is on the "
            "emergency stop."
        )


@dataclass(frozen=True)
class ConfirmFree:
    """Confirm that an axis stands free at one of its limits."""

    axis: str
    position: float
    unit: str

    @property
    def text(self) -> str:
        """Return the request as a sentence."""
        return (
            f"The axis {self.axis} stands at its limit, {self.position:g} {self.unit}. Confirm that it stands free of "
            "every stop, cable and frame."
        )


@dataclass(frozen=True)
class ReadScale:
    """Read how far an axis has gone on graph paper, a ruler or a protractor; the answer is a number."""

    axis: str
    unit: str
    instruction: str

    @property
    def text(self) -> str:
        """Return the request as a sentence."""
        return f"{self.instruction} Type the reading of the axis {self.axis} in {self.unit}."


@dataclass(frozen=True)
class ConfirmFaultReset:
    """Confirm that the cause of a drive's fault is gone, so that it may be reset."""

    fault: str
    remedy: str

    @property
    def text(self) -> str:
        """Return the request as a sentence."""
        return (
            f"{self.fault}. What to do: {self.remedy}. Confirm that the cause is gone and the fault may be reset; "
            "nothing moves by that."
        )


@dataclass(frozen=True)
class ConfirmStance:
    """Confirm where the needle stands, where the drives have lost it."""

    run: str
    insertion_mm: float
    rotation_rad: float
    linear_mm: float
    lost: tuple[str, ...]

    @property
    def text(self) -> str:
        """Return the request as a sentence."""
        return (
            f"The axes {', '.join(self.lost)} have lost their positions. At the end of run {self.run} the needle stood "
            f"{self.insertion_mm:.1f} mm out of the sheath, turned by {self.rotation_rad:.2f} rad, the sheath "
            f"{self.linear_mm:.1f} mm in. Look at needle and picture: confirm that they still stand so."
        )


@dataclass(frozen=True)
class ConfirmWithdrawal:
    """Confirm that the needle may be withdrawn along its path."""

    moves: tuple[str, ...]

    @property
    def text(self) -> str:
        """Return the request as a sentence."""
        return (
            f"The needle is going to be withdrawn slowly: {'; '.join(self.moves)}. Confirm it, with a hand on the "
            "emergency stop."
        )


OperatorRequest = (
    MountNeedle
    | ConfirmAxesAtZero
    | PlaceSpecimen
    | ShiftToHole
    | PlacePhantom
    | PickTarget
    | ConfirmPlan
    | ConfirmStopped
    | HoldBoard
    | LayGraphPaper
    | ClearBench
    | ConfirmNeedleOut
    | WithdrawNeedle
    | ConfirmHere
    | ConfirmMotion
    | ConfirmFree
    | ReadScale
    | ConfirmFaultReset
    | ConfirmStance
    | ConfirmWithdrawal
)


def request_details(request: OperatorRequest, run: Path) -> dict[str, object]:
    """Return what a request says, for a record; files of the run are named relative to its folder."""
    return {
        key: value.removeprefix(f"{run}/") if isinstance(value, str) else value
        for key, value in asdict(request).items()
    }


@dataclass(frozen=True)
class Answer:
    """What the operator said: done or refused, a note for the record, and the reading or pixel that was asked for."""

    confirmed: bool
    note: str = ""
    reading: float | None = None
    pixel: tuple[float, float] | None = None


class Operator(Protocol):
    """Whoever does what the rig cannot do by itself."""

    def ask(self, request: OperatorRequest, meanwhile: Callable[[], None]) -> Answer:
        """Ask, wait until it is done or refused, and return the answer.

        Whoever has to wait calls `meanwhile` ten times a second or more: the drives hear the computer by it.
        """
        ...
