"""The CANopen side of a simulated drive (CiA 301): NMT, boot-up, SDO, reports at SYNC, EMCY, heartbeats."""

import math
import struct
from enum import IntEnum

import can

from labrig.clock import Clock
from labrig.devices.drives import objects as co
from labrig.devices.drives.eds import make_form
from labrig.devices.drives.objects import Place
from labrig.devices.simulated.bus import InProcessBus, InProcessWire
from labrig.devices.simulated.dictionary import MAPPINGS, NMT_STATE, ObjectDictionary

_SYNC = 0x080
_LAST_SYNCHRONOUS = 240
"""Highest transmission type of a PDO that is sent at SYNC."""

_REPORT_PLACES = frozenset((*co.TRANSMIT_PDO_COB_IDS, *co.TPDO_TYPES, *MAPPINGS))


class NmtState(IntEnum):
    """State of a node, as in its heartbeat; OFF means no power or still booting."""

    OFF = -1
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class CanopenNode:
    """The CANopen node of a simulated drive; a drive derives from it and adds what it does.

    Parameters
    ----------
    wire : InProcessWire
        The bus.
    node_id : int
        Its node id.
    clock : Clock
        Its time.
    objects : ObjectDictionary
        Its objects.
    """

    def __init__(self, wire: InProcessWire, node_id: int, clock: Clock, objects: ObjectDictionary) -> None:
        self.node_id = node_id
        self.nmt_state = NmtState.OFF
        self._is_mute = False
        self._clock = clock
        self._next_beat_s = math.inf
        self._heard_s: float | None = None
        self.objects = objects
        objects.refuse, objects.written = self._refuse, self._on_write
        self._read_settings()
        self._wire = wire
        self.line = InProcessBus(wire, self._on_frame)

    def tick(self) -> None:
        """Do what is due by now; called before each frame for this node too."""

    def _obey_nmt(self, command: int) -> None:
        """Carry out an NMT command for this node."""

    def lose_master(self, t_s: float) -> None:
        """React to the end of the computer's heartbeat, which was missed at this instant."""

    # What it sends

    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame, unless this node is mute or off."""
        if not self._is_mute and self.nmt_state is not NmtState.OFF:
            self.line.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def send_emergency(self, code: int, register: int) -> None:
        """Send an EMCY frame; not while stopped."""
        if self.nmt_state is not NmtState.STOPPED:
            self.send(0x080 + self.node_id, struct.pack("<HB5x", code, register))

    def boot(self) -> None:
        """Announce the node, and become pre-operational."""
        self.nmt_state = NmtState.PRE_OPERATIONAL
        self.send(0x700 + self.node_id, b"\0")
        self._heard_s = None
        self._read_settings()

    def send_due(self, now_s: float) -> None:
        """Send what is due, and notice a master that has been silent for too long."""
        if self.nmt_state is NmtState.OFF:
            return
        while self._next_beat_s <= now_s:
            period_s = self.objects.values[co.PRODUCER_HEARTBEAT] / 1000
            self._next_beat_s = round(self._next_beat_s + period_s, 6)
            self.send(0x700 + self.node_id, bytes([self.nmt_state]))
        if self._heard_s is not None and now_s > (deadline_s := self._heard_s + self._patience_s):
            self._heard_s = None
            self.lose_master(deadline_s)

    def _send_reports(self) -> None:
        for can_id, (form, places) in self._reports.items():
            self.send(can_id, form.pack(*map(self.objects.value, places)))

    def _read_settings(self) -> None:
        """Read both heartbeats and the reports again; a master is missed only after its next beat."""
        values = self.objects.values
        watched = values[co.CONSUMER_HEARTBEAT]
        self._master_id = 0x700 + (watched >> 16 & 0x7F) if watched & 0xFFFF else -1
        self._heeded = {0x000, _SYNC, 0x600 + self.node_id, self._master_id}
        self._patience_s = (watched & 0xFFFF) / 1000
        self._heard_s = None if self._master_id < 0 else self._heard_s
        self._next_beat_s = self._clock.now_s() if values[co.PRODUCER_HEARTBEAT] else math.inf
        self._read_reports()

    def _read_reports(self) -> None:
        """Read which PDOs are sent at SYNC, and what they carry."""
        values, known, self._reports = self.objects.values, self.objects.variables, {}
        for cob_id, kind, mapping in zip(co.TRANSMIT_PDO_COB_IDS, co.TPDO_TYPES, co.TPDO_MAPS, strict=True):
            if values[cob_id] & co.PDO_INVALID or not 0 < values[kind] <= _LAST_SYNCHRONOUS:
                continue
            codes = [values[place] for place in mapping[1 : values[mapping[0]] + 1]]
            places = [Place(code >> 16, code >> 8 & 0xFF) for code in codes]
            self._reports[values[cob_id] & 0x7FF] = (make_form(known[place] for place in places), places)

    # What fault scripts do to it

    def mute(self) -> None:
        """Send nothing from now on."""
        self._is_mute = True

    def unplug(self) -> None:
        """Leave the bus silently; a moving shaft keeps moving."""
        self.line.shutdown()

    # What it hears

    def _refuse(self, place: Place) -> int | None:
        """Return the abort code if an object cannot be written now, whatever the value."""
        is_mapping = place in MAPPINGS and self.nmt_state is not NmtState.PRE_OPERATIONAL
        return NMT_STATE if is_mapping else None

    def _on_write(self, place: Place, value: int, before: int) -> None:  # noqa: ARG002 - a drive needs them
        if place in {co.CONSUMER_HEARTBEAT, co.PRODUCER_HEARTBEAT}:
            self._read_settings()
        elif place in _REPORT_PLACES:
            self._read_reports()

    def _on_frame(self, message: can.Message) -> None:
        can_id = message.arbitration_id
        if can_id not in self._heeded or self.nmt_state is NmtState.OFF:
            return
        if message.is_extended_id or message.is_error_frame or message.is_remote_frame:
            return
        if can_id == 0x600 + self.node_id:
            self.tick()
            response = (
                None if self.nmt_state is NmtState.STOPPED else self.objects.answer(bytes(message.data))
            )
            if response is not None:
                self.send(0x580 + self.node_id, response)
        elif can_id == 0x000:
            data = bytes(message.data)
            if len(data) == 2 and data[1] in {0, self.node_id}:
                self.tick()
                self._obey_nmt(data[0])
        elif can_id == self._master_id:
            self._heard_s = self._clock.now_s()
        elif can_id == _SYNC and self.nmt_state is NmtState.OPERATIONAL:
            self.tick()
            self._send_reports()
