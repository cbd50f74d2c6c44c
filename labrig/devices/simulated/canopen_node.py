"""The CANopen side of a simulated drive (CiA 301): NMT, boot-up, SDO, PDO, EMCY, heartbeats, SYNC."""

import math
import struct
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping
from enum import IntEnum

import can

from labrig.clock import Clock
from labrig.devices.drives import objects as co
from labrig.devices.drives.eds import Eds
from labrig.devices.drives.objects import Place
from labrig.devices.simulated.bus import InProcessBus, InProcessWire
from labrig.devices.simulated.dictionary import ObjectDictionary
from labrig.devices.simulated.pdo import PdoEngine
from labrig.devices.simulated.sdo_server import SdoServer

_PDO_INDICES = frozenset(
    {co.SYNC_ID.index}
    | {place.index for place in (*co.RECEIVE_PDO_COB_IDS, *co.TRANSMIT_PDO_COB_IDS)}
    | {mapping[0].index for mapping in (*co.RPDO_MAPS, *co.TPDO_MAPS)}
)


class NmtState(IntEnum):
    """State of a node, as in its heartbeat; OFF means no power or still booting."""

    OFF = -1
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class CanopenNode(ABC):
    """The CANopen node of a simulated drive; a drive derives from it and adds what it does.

    Parameters
    ----------
    wire : InProcessWire
        The bus.
    node_id : int
        Its node id.
    clock : Clock
        Its time.
    eds, fixed, while_unpowered, fingerprint
        As `ObjectDictionary` takes them.
    """

    def __init__(
        self,
        wire: InProcessWire,
        node_id: int,
        clock: Clock,
        *,
        eds: Eds,
        fixed: Mapping[Place, int],
        while_unpowered: frozenset[Place] = frozenset(),
        fingerprint: tuple[Place, ...] = (),
    ) -> None:
        self.node_id = node_id
        self.nmt_state = NmtState.OFF
        self._mute_frames: float = 0
        self._deaf = self._beatless = False
        self._aborts: deque[tuple[int, int | None]] = deque()
        self._ignored = 0
        self._clock = clock
        self._next_beat_s = math.inf
        self._heard_s: dict[int, float] = {}
        self.objects = ObjectDictionary(
            eds,
            node_id,
            fixed,
            self.live_objects(),
            self._on_write,
            is_powered=self.is_powered,
            is_pre_operational=lambda: self.nmt_state is NmtState.PRE_OPERATIONAL,
            while_unpowered=while_unpowered,
            fingerprint=fingerprint,
        )
        self._sdo = SdoServer(self.objects.read, self.objects.write)
        self.pdo = PdoEngine(self.objects, self.send, self.fail)
        self._wire = wire
        self._bus = InProcessBus(wire, self._on_frame)

    @abstractmethod
    def live_objects(self) -> dict[Place, Callable[[], int]]:
        """Return the objects whose value is made when it is read."""

    @abstractmethod
    def is_powered(self) -> bool:
        """Tell whether the power stage is on: some objects cannot be written then."""

    @abstractmethod
    def tick(self) -> None:
        """Do what is due by now; called before each frame for this node too."""

    @abstractmethod
    def _obey_nmt(self, command: int) -> None:
        """Carry out an NMT command for this node."""

    @abstractmethod
    def lose_master(self, t_s: float) -> None:
        """React to the end of the computer's heartbeat, which was missed at this instant."""

    @abstractmethod
    def fail(self, code: int) -> None:
        """Go to fault with an error code, such as that of a PDO of the wrong length."""

    # What it sends

    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame, unless this node is mute or off."""
        if self._mute_frames:
            self._mute_frames -= 1
        elif self.nmt_state is not NmtState.OFF:
            self._bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def send_emergency(self, code: int, register: int) -> None:
        """Send an EMCY frame; not while stopped, nor with 0x1014 switched off."""
        cob_id = self.objects.values[co.EMERGENCY_ID]
        if self.nmt_state is not NmtState.STOPPED and not cob_id & co.PDO_INVALID:
            self.send(cob_id & 0x7FF, struct.pack("<HB5x", code, register))

    def boot(self) -> None:
        """Announce the node, and become pre-operational."""
        self.nmt_state = NmtState.PRE_OPERATIONAL
        self.pdo.configure()
        self.send(0x700 + self.node_id, b"\0")
        self._heard_s.clear()
        self._watch_heartbeats()

    def enter(self, state: NmtState) -> None:
        """Change the NMT state."""
        if state is NmtState.OPERATIONAL and self.nmt_state is not NmtState.OPERATIONAL:
            self.pdo.configure()
        self.nmt_state = state

    def send_due(self, now_s: float) -> None:
        """Send what is due, and notice a master that has been silent for too long."""
        self._wire.tick(now_s)
        if self.nmt_state is NmtState.OFF:
            return
        while self._next_beat_s <= now_s:
            period_s = self.objects.values[co.PRODUCER_HEARTBEAT] / 1000
            self._next_beat_s = round(self._next_beat_s + period_s, 6)
            if not self._beatless:
                self.send(0x700 + self.node_id, bytes([self.nmt_state]))
        for node, heard_s in tuple(self._heard_s.items()):
            deadline_s = heard_s + self._consumed[node]
            if now_s > deadline_s:
                del self._heard_s[node]
                self.lose_master(deadline_s)
        if self.nmt_state is NmtState.OPERATIONAL:
            self.pdo.send_changes()

    def _watch_heartbeats(self) -> None:
        """Read the times of both heartbeats again; a master is missed only after its next one."""
        values = self.objects.values
        watched = (values[co.CONSUMER_HEARTBEAT], values[co.CONSUMER_HEARTBEAT_2])
        self._consumed = {value >> 16 & 0x7F: (value & 0xFFFF) / 1000 for value in watched if value & 0xFFFF}
        self._heard_s = {node: t for node, t in self._heard_s.items() if node in self._consumed}
        self._next_beat_s = self._clock.now_s() if values[co.PRODUCER_HEARTBEAT] else math.inf

    # What tests and fault scripts do to it

    def mute(self, frames: int | None = None) -> None:
        """Drop the next frames that this node sends, or all of them."""
        self._mute_frames = math.inf if frames is None else frames

    def deafen(self) -> None:
        """Receive nothing."""
        self._deaf = True

    def recover(self) -> None:
        """Receive and send again."""
        self._mute_frames, self._deaf = 0, False

    def abort_next(self, code: int, index: int | None = None) -> None:
        """Refuse the next SDO request, or the next one for an object, with an abort code."""
        self._aborts.append((code, index))

    def ignore_next(self, requests: int = 1) -> None:
        """Ignore the next SDO requests."""
        self._ignored += requests

    def stop_heartbeat(self) -> None:
        """Stop the heartbeat; everything else continues."""
        self._beatless = True

    def unplug(self) -> None:
        """Leave the bus silently; a moving shaft keeps moving."""
        self._bus.shutdown()

    # What it hears

    def _on_write(self, place: Place, value: int, before: int) -> None:  # noqa: ARG002 - a drive needs them
        if place in {co.CONSUMER_HEARTBEAT, co.CONSUMER_HEARTBEAT_2, co.PRODUCER_HEARTBEAT}:
            self._watch_heartbeats()
        elif place.index in _PDO_INDICES:
            self.pdo.configure()

    def _on_frame(self, message: can.Message) -> None:
        is_data = not (message.is_extended_id or message.is_error_frame or message.is_remote_frame)
        if self._deaf or self.nmt_state is NmtState.OFF or not is_data:
            return
        can_id, data = message.arbitration_id, bytes(message.data)
        if can_id == 0x600 + self.node_id:
            self.tick()
            self._on_sdo(data)
        elif can_id == 0x000:
            if len(data) == 2 and data[1] in {0, self.node_id}:
                self.tick()
                self._obey_nmt(data[0])
        elif can_id >= 0x700:
            if can_id - 0x700 in self._consumed:
                self._heard_s[can_id - 0x700] = self._clock.now_s()
        elif self.nmt_state is NmtState.OPERATIONAL and self.pdo.listens_to(can_id):
            self.tick()
            self.pdo.take(can_id, data)

    def _on_sdo(self, request: bytes) -> None:
        if self.nmt_state is NmtState.STOPPED:
            return
        if self._ignored:
            self._ignored -= 1
            return
        response = self._take_scripted_abort(request) or self._sdo.answer(request)
        if response is not None:
            self.send(0x580 + self.node_id, response)
        if self.nmt_state is NmtState.OPERATIONAL:
            self.pdo.send_changes()

    def _take_scripted_abort(self, request: bytes) -> bytes | None:
        if not self._aborts or len(request) != 8:
            return None
        code, index = self._aborts[0]
        if index not in {None, int.from_bytes(request[1:3], "little")}:
            return None
        self._aborts.popleft()
        return b"\x80" + request[1:4] + code.to_bytes(4, "little")
