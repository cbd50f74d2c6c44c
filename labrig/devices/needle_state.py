"""The state of a rig across runs: whether a needle is in tissue, referenced axes, the needle's roll zero and torsion.

The file is replaced atomically and forced to disk. If it is missing or damaged, a needle may be in tissue. A file of
something else is never replaced.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated

from pydantic import Field, TypeAdapter

from labrig.devices.axis_description import AXES
from labrig.durable import write_atomically
from labrig.errors import OutputExistsError, SafetyStopError
from labrig.input_file import parse_json, read_file
from labrig.steering.torsion import TorsionalLag

_KIND = "labrig-rig-state"
_VERSION = 1
_HEAD = {"kind": _KIND, "schema_version": _VERSION}

Do = Callable[[Callable[[], None]], None]
"""Does something that may block, and returns when it is done."""

_Sd = Annotated[float, Field(ge=0)]


@dataclass(frozen=True)
class RollZero:
    """Position of the rotation axis at which the needle bends towards -y, as certified by a run.

    Parameters
    ----------
    needle_id : str
        The needle, as it is clamped.
    zero_rad, sd_rad : float
        Position of the rotation axis, and its standard deviation.
    run : str
        The run that found it.
    torsion : TorsionalLag or None
        Of the needle as it is clamped, by the same run; None if it was not measured.
    """

    needle_id: str
    zero_rad: float
    sd_rad: _Sd
    run: str
    torsion: TorsionalLag | None = None

    @property
    def lag(self) -> TorsionalLag:
        """The lag of the bevel at each depth: as measured, or that of a needle whose torsion was not measured."""
        return self.torsion or TorsionalLag()


@dataclass(frozen=True)
class RigState:
    """The state of the rig.

    Parameters
    ----------
    needle_in_tissue : bool or None
        None if unknown.
    since_run : str or None
        The run that put the needle there.
    referenced : tuple of str
        Axes with a valid reference.
    note : str
        Why something is unknown.
    roll_zero : RollZero or None
        None if none is certified. It is lost with the reference of the rotation axis.
    current_limits : mapping of str to pair of int
        Axis -> its drive's own current limit and the one that labrig has set while it has the rig open [mA]; a labrig
        that was killed has left the second one there.
    """

    needle_in_tissue: bool | None
    since_run: str | None = None
    referenced: tuple[str, ...] = ()
    note: str = ""
    roll_zero: RollZero | None = None
    current_limits: Mapping[str, tuple[int, int]] = field(default_factory=dict)

    @property
    def place(self) -> str:
        """Whether a needle is in tissue, as the end of a sentence."""
        if self.needle_in_tissue is None:
            return f"whether a needle is in tissue is not known ({self.doubt})"
        return "the needle is in tissue" if self.needle_in_tissue else "no needle is in tissue"

    @property
    def doubt(self) -> str:
        """Why a needle may be in tissue; empty if none is."""
        if self.needle_in_tissue:
            return f"run {self.since_run} ended with the needle in tissue"
        return "" if self.needle_in_tissue is False else self.note

    def find_way_out(self, rig_option: str) -> str:
        """Return what to do about that doubt, on the rig of this option; empty if there is none."""
        if self.needle_in_tissue:
            return (
                f"take it out along its path: labrig devices withdraw {rig_option} --run {self.since_run}; "
                "after one by hand, the next labrig run asks to confirm that it is out"
            )
        if self.needle_in_tissue is None:
            return (
                "look whether a needle is in tissue: labrig devices jog and home, and a run, have you confirm "
                "that none is before anything moves"
            )
        return ""


_STATE = TypeAdapter(RigState)

NEW = RigState(needle_in_tissue=False)
"""State of a simulated rig, whose drives and world are new."""


class NeedleState:
    """Keeps the state of a rig in a file, or, without a path, in memory.

    Every change is on disk before it returns, and may raise `DiskError`.

    Parameters
    ----------
    path : Path or None
        The file; None for a rig that is new in every run.
    state : RigState
        The state without a file.
    do : callable
        Does what waits for the disk.
    """

    def __init__(self, path: Path | None, state: RigState = NEW, do: Do = lambda call: call()) -> None:
        self._path = path
        self._do = do
        self.state = state if path is None else load_state(path)

    def update(self, **changes: object) -> None:
        """Change the state and put it on disk before returning. Raises `DiskError`."""
        self.state = _drop_void_roll_zero(replace(self.state, **changes))  # type: ignore[arg-type]
        if self._path is not None:
            self._do(partial(_save, self._path, self.state))

    def mark_in_tissue(self, run: str) -> None:
        """Remember, across a crash, that `run` is putting a needle into tissue."""
        self.update(needle_in_tissue=True, since_run=run, note="")

    def mark_out(self) -> None:
        """Remember that no needle is in tissue."""
        self.update(needle_in_tissue=False, since_run=None, note="")

    def refuse_in_tissue(self, what: str, rig_option: str) -> None:
        """Refuse an action on the rig of an option while a needle may be in tissue. Raises `SafetyStopError`."""
        if self.state.needle_in_tissue is not False:
            raise SafetyStopError(f"{what}: {self.state.doubt}", self.state.find_way_out(rig_option))

    def note_reference(self, axis: str) -> None:
        """Remember that an axis has its reference."""
        kept = {*self.state.referenced, axis}
        self.update(referenced=tuple(name for name in AXES if name in kept))

    def forget_references(self, axes: Iterable[str]) -> None:
        """Remember that axes have lost their reference; write only a change."""
        lost = set(axes)
        referenced = tuple(name for name in self.state.referenced if name not in lost)
        if referenced != self.state.referenced:
            self.update(referenced=referenced)

    def note_current_limit(self, axis: str, own_ma: int, set_ma: int) -> None:
        """Remember the current limit that a drive has of its own before another one is set [mA]."""
        self.update(current_limits={**self.state.current_limits, axis: (own_ma, set_ma)})

    def forget_current_limits(self) -> None:
        """Remember that every drive has its own current limit again; write only a change."""
        if self.state.current_limits:
            self.update(current_limits={})

    def recall_roll_zero(self, needle_id: str) -> RollZero | None:
        """Return the certified roll zero of this needle as it is clamped, or None."""
        known = self.state.roll_zero
        return known if known is not None and known.needle_id == needle_id else None

    def certify_roll_zero(self, roll_zero: RollZero) -> None:
        """Remember the needle's roll zero until it is clamped again or the rotation axis loses its reference.

        Raises
        ------
        SafetyStopError
            When the rotation axis has no reference: the roll would mean nothing.
        """
        if "rotation" not in self.state.referenced:
            raise SafetyStopError(
                "axis rotation is not referenced: it has no roll", "reference the axes first"
            )
        self.update(roll_zero=roll_zero)


def _drop_void_roll_zero(state: RigState) -> RigState:
    """Drop a roll zero that does not refer to the present zero of the rotation axis."""
    return state if "rotation" in state.referenced else replace(state, roll_zero=None)


def load_state(path: Path | None) -> RigState:
    """Return the state in a file; one that is missing, empty or damaged leaves in doubt where the needle is.

    Raises
    ------
    OutputExistsError
        For a file of something else: it would be replaced.
    """
    if path is None:
        return NEW
    if not path.exists():
        return RigState(None, note="this rig has no state file yet")
    text = b""
    try:
        text = read_file(path)
        document = parse_json(text)
        if not isinstance(document, dict) or {**document, **_HEAD} != document:
            raise ValueError(f"it is no {_KIND} of version {_VERSION}")
        return parse_rig_state(document)
    except (OSError, ValueError) as error:
        if text and f'"{_KIND}"'.encode() not in text:
            raise OutputExistsError(
                f"{path} is named as the state file of the rig and holds something else",
                "name another file under state_file: in the rig file; move a damaged state file away, and the next run "
                "asks whether a needle is in tissue",
            ) from error
        reason = str(error).splitlines()[0]
        return RigState(None, note=f"the rig's state file {path.name} cannot be read ({reason})")


def parse_rig_state(document: object) -> RigState:
    """Return the state of a state file or a record. Raises `ValueError`."""
    return _STATE.validate_json(json.dumps(document), strict=True)


def _save(path: Path, state: RigState) -> None:
    document = {**_HEAD, **asdict(state)}
    write_atomically(path, (json.dumps(document, indent=2) + "\n").encode())
