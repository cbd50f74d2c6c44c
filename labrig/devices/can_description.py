"""The section `can` of a rig file: which bus the drives stand on, and the heartbeats on it."""

from collections.abc import Iterable, Iterator
from difflib import get_close_matches
from typing import Annotated, Literal, get_args

import can
from pydantic import Field

from labrig.protocol.model import Conflict, Model

NodeId = Annotated[int, Field(ge=1, le=127)]

ONLY_SIMULATED = "simulated"
"""Name of the in-process CAN interface, and of a kind of rig."""


_MOST_FRAME_BITS = 135
"""A frame of 8 bytes with every stuff bit and the space to the next (Davis et al. 2007, eq. 2) [bit]."""

_LOOK_PERIOD_MS, _MOST_LOOK_MS = 100, 50
"""labrig looks after the axes so often, and a look may occupy the bus for so long [ms]."""

Bitrate = Literal[20_000, 50_000, 125_000, 250_000, 500_000, 800_000, 1_000_000]


class HeartbeatDescription(Model):
    """Heartbeats: the drives stop when the computer's stops, and the computer stops them when one of theirs does."""

    computer_node_id: NodeId = 127
    """Node id under which the computer beats."""
    period_ms: Annotated[int, Field(ge=10, le=1000)] = 100
    """A beat this often [ms]."""
    timeout_ms: Annotated[int, Field(ge=100, le=10_000)] = 500
    """Silence after which the drives stop by themselves, and the computer stops them [ms]."""

    def conflicts(self) -> Iterable[Conflict]:
        """Yield a timeout that one late beat would trip."""
        if self.timeout_ms < 3 * self.period_ms:
            yield Conflict(
                "timeout_ms",
                f"timeout_ms is {self.timeout_ms}, below three periods of {self.period_ms}",
                f"write {3 * self.period_ms} or more, or beat more often",
            )


class CanDescription(Model):
    """The CAN bus on which the drives stand."""

    interface: Annotated[str, Field(min_length=1, max_length=40)]
    """Interface of python-can (socketcan, pcan, kvaser, ixxat, slcan, ...); simulated stands for a bus inside
    the process."""
    channel: Annotated[str, Field(max_length=200)] = ""
    """Channel of the interface, such as can0."""
    bitrate: Bitrate = 1_000_000
    """Bit rate; the drives must be set to the same [bit/s]."""
    answer_timeout_ms: Annotated[int, Field(ge=20, le=5000)] = 120
    """How long a drive may take to answer before it is asked once more; with the default a silent drive is
    found out, and every axis stopped, within half a second [ms]."""
    options: dict[str, str | int | float | bool] = Field(default_factory=dict)
    """Further arguments of the python-can interface, by name."""
    heartbeat: HeartbeatDescription = Field(default_factory=HeartbeatDescription)
    """Heartbeats."""

    def conflicts(self) -> Iterable[Conflict]:
        """Yield an interface that python-can does not know."""
        known = sorted({ONLY_SIMULATED, *can.VALID_INTERFACES})
        if self.interface not in known:
            near = get_close_matches(self.interface, known, 1)
            hint = f"did you mean {near[0]}?" if near else f"python-can knows {', '.join(known)}"
            yield Conflict("interface", f"unknown interface {self.interface}", hint)

    def problems(self, drives: int) -> Iterator[Conflict]:
        """Yield a bit rate at which so many drives cannot be looked after; a bus inside the process has none."""
        took_ms = _look_ms(drives, self.bitrate)
        if self.interface != ONLY_SIMULATED and took_ms > _MOST_LOOK_MS:
            least = min(rate for rate in get_args(Bitrate) if _look_ms(drives, rate) <= _MOST_LOOK_MS)
            yield Conflict(
                "bitrate",
                f"bitrate is {self.bitrate}: to look at {drives} drives takes {_count_frames(drives)} frames of up to "
                f"{_MOST_FRAME_BITS} bits, {took_ms:.0f} ms of every {_LOOK_PERIOD_MS} ms; at most {_MOST_LOOK_MS} ms "
                "leave room for moves and stops",
                f"set the drives, and bitrate, to {least} bit/s or more",
            )


def _count_frames(drives: int) -> int:
    """Return the frames of a look at the drives.

    Statusword, position and target as requests with answers, and a heartbeat of each; the SYNC and labrig's heartbeat.
    """
    return 7 * drives + 2


def _look_ms(drives: int, bitrate: int) -> float:
    """Return for how long a look at the drives occupies the bus, at most [ms]."""
    return 1000 * _count_frames(drives) * _MOST_FRAME_BITS / bitrate
