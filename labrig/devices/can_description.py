"""The section `can` of a rig file: which bus the drives stand on, and the heartbeats on it."""

from collections.abc import Iterable
from typing import Annotated, Literal

import can
from pydantic import Field

from labrig.protocol.model import Conflict, Model

NodeId = Annotated[int, Field(ge=1, le=127)]

ONLY_SIMULATED = "simulated"
"""Name of the in-process CAN interface, and of a kind of rig."""


Bitrate = Literal[125_000, 250_000, 500_000, 800_000, 1_000_000]
"""A slower bus has no room for moves and stops: to look at three drives takes 23 frames of up to 135 bits (Davis et al.
2007, eq. 2), 62 ms at 50 kbit/s, and labrig looks after its axes every 100 ms."""


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
    answer_timeout_ms: Annotated[int, Field(ge=20, le=5000)] = 80
    """How long a drive may take to answer before it is asked once more; with the default a drive that answers
    nothing is found out, and its axis stands still, within 0.4 s [ms]."""
    options: dict[str, str | int | float | bool] = Field(default_factory=dict)
    """Further arguments of the python-can interface, by name."""
    heartbeat: HeartbeatDescription = Field(default_factory=HeartbeatDescription)
    """Heartbeats."""

    def conflicts(self) -> Iterable[Conflict]:
        """Yield an interface that python-can does not know."""
        known = sorted({ONLY_SIMULATED, *can.VALID_INTERFACES})
        if self.interface not in known:
            yield Conflict(
                "interface", f"unknown interface {self.interface}", f"python-can knows {', '.join(known)}"
            )
        if self.interface == "udp_multicast" or self.options.get("receive_own_messages"):
            message = "labrig would receive what it sends, and take itself for another master"
            yield Conflict("interface", message, "use an interface that delivers to others alone")
