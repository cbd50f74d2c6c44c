"""Watches the bus for another master of the same drives.

Two programs that beat as the same computer defeat the dead-man: the drives go on when one of them is killed. What
labrig sends itself does not come back to it, so that every such frame that arrives is another program's.

What is decided here
--------------------
- A frame that could move or free an axis stops a run: an NMT command, a receive PDO, an SDO request that writes, a
  heartbeat under the computer's node id. SDO requests that only read are let pass during a run.
- An axis whose mode of operation another program has changed counts as without a reference: it may have been homed.
- While the rig is opened, reading is refused too: whoever reads is about to command, and its answers mix with ours.
"""

import struct
from collections.abc import Mapping

from labrig.clock import Clock
from labrig.devices.bus import CanLink
from labrig.devices.can_description import HeartbeatDescription
from labrig.devices.drives.objects import MODE, Place
from labrig.errors import SecondMasterError

_NMT, _NMT_ALL = 0x000, 0
_RECEIVE_PDOS = (0x200, 0x300, 0x400, 0x500)
_SDO_READS = frozenset({2, 3, 4, 5})
"""Command specifiers of SDO requests that write nothing: upload, its segments, abort, block upload."""

_SDO_INITIATES = {1: "writes", 2: "reads"}
"""Command specifiers of SDO requests that name their object: download and upload."""

_WRITES_MODE = struct.pack("<BHB", 0x2F, MODE.index, MODE.subindex)
"""Head of an SDO request that writes the mode of operation, one byte long."""

_BEATS_LISTENED_FOR = 3
"""Periods of the heartbeat for which the bus is listened to: no drive allows a longer gap."""

_END_IT = (
    "find the other program that uses this bus, and end it: two masters defeat the dead-man of the drives"
)

_Frame = tuple[int, bytes]
"""COB-ID and data."""


class BusWatch:
    """Notes the first frame of another master.

    Parameters
    ----------
    link : CanLink
        The bus.
    axes : mapping of int to str
        Node id of each drive -> its axis.
    heartbeat : HeartbeatDescription
        Under which node id labrig itself beats, and how often.

    Attributes
    ----------
    link : CanLink
        The bus.
    without_zero : set of str
        Axes whose mode another program has changed: it may have homed them, and nobody knows their zero.
    """

    def __init__(self, link: CanLink, axes: Mapping[int, str], heartbeat: HeartbeatDescription) -> None:
        self.link = link
        self._axes = axes
        self._period_s = heartbeat.period_ms / 1000
        self._command: _Frame | None = None
        self._request: _Frame | None = None
        self.without_zero: set[str] = set()
        network = link.network
        network.subscribe(_NMT, self._on_nmt)
        network.subscribe(0x700 + heartbeat.computer_node_id, self._on_command)
        for node in axes:
            network.subscribe(0x600 + node, self._on_request)
            for base in _RECEIVE_PDOS:
                network.subscribe(base + node, self._on_command)

    def listen(self, clock: Clock) -> None:
        """Listen, before anything is sent, for another program on the bus. Raises `SecondMasterError`."""
        self._command = self._request = None
        clock.sleep(_BEATS_LISTENED_FOR * self._period_s)
        self.require_free()

    def require_free(self) -> None:
        """Require that no other program has asked, commanded or beaten since the bus was opened.

        Raises
        ------
        SecondMasterError
            Names the frame.
        """
        self._raise_if(self._command or self._request)

    def require_no_command(self) -> None:
        """Raise `SecondMasterError` if another program has commanded the drives or beaten as labrig does."""
        self._raise_if(self._command)

    def _raise_if(self, frame: _Frame | None) -> None:
        if frame is not None:
            raise SecondMasterError(
                f"another program uses the CAN bus of the drives: {self._explain(frame)}", _END_IT
            )

    def _explain(self, frame: _Frame) -> str:
        can_id, data = frame
        node = can_id & 0x7F
        if can_id > 0x700:
            return f"it sends the heartbeat of node {node}, as labrig does"
        if can_id == _NMT:
            return f"NMT command 0x{data[0]:02X} to node {data[1]}"
        if can_id > 0x600 and len(data) == 8 and data[0] >> 5 in _SDO_INITIATES:
            place, does = Place(int.from_bytes(data[1:3], "little"), data[3]), _SDO_INITIATES[data[0] >> 5]
            return f"it {does} object {place} of axis {self._axes[node]}"
        return f"CAN frame {can_id:03X}#{data.hex().upper()} to axis {self._axes[node]}"

    def _on_nmt(self, can_id: int, data: bytearray, _timestamp: float) -> None:
        if len(data) == 2 and (data[1] == _NMT_ALL or data[1] in self._axes):
            self._on_command(can_id, data, _timestamp)

    def _on_request(self, can_id: int, data: bytearray, _timestamp: float) -> None:
        self._request = self._request or (can_id, bytes(data))
        if data[:4] == _WRITES_MODE:
            self.without_zero.add(self._axes[can_id & 0x7F])
        if not data or data[0] >> 5 not in _SDO_READS:
            self._on_command(can_id, data, _timestamp)

    def _on_command(self, can_id: int, data: bytearray, _timestamp: float) -> None:
        self._command = self._command or (can_id, bytes(data))
