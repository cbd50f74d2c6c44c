"""The CANopen side of a simulated drive (CiA 301): NMT, boot-up, SDO, PDO, EMCY, heartbeat, guarding, SYNC."""

import math
import struct
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping
from enum import IntEnum

import can

from labrig.clock import Clock
from labrig.devices import canopen_objects as co
from labrig.devices.canopen_objects import Entry
from labrig.devices.simulated.bus import InProcessBus, InProcessWire
from labrig.devices.simulated.dictionary import ObjectDictionary, ObjectTable
from labrig.devices.simulated.error_control import ErrorControl
from labrig.devices.simulated.pdo import PdoEngine
from labrig.devices.simulated.sdo_server import SdoServer

_PDO_ENTRIES = frozenset(
    {co.SYNC_ID, *co.RECEIVE_PDO_COB_IDS, *co.TRANSMIT_PDO_COB_IDS, *co.TPDO_TYPES, co.RESTORE_PDO_IDS}
)
_WATCH_ENTRIES = frozenset({co.CONSUMER_HEARTBEAT, co.CONSUMER_HEARTBEAT_2, co.PRODUCER_HEARTBEAT})


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
    table, fixed
        As `ObjectDictionary` takes them.
    """

    def __init__(
        self,
        wire: InProcessWire,
        node_id: int,
        clock: Clock,
        table: ObjectTable,
        fixed: Mapping[Entry, int],
    ) -> None:
        self.node_id = node_id
        self.nmt_state = NmtState.OFF
        self._mute_frames: float = 0
        self._deaf = False
        self._aborts: deque[tuple[int, int | None]] = deque()
        self._ignored = 0
        self._clock = clock
        self.objects = ObjectDictionary(
            table,
            node_id,
            fixed,
            self.live_objects(),
            self._on_write,
            is_powered=self.is_powered,
            is_pre_operational=lambda: self.nmt_state is NmtState.PRE_OPERATIONAL,
        )
        self._sdo = SdoServer(self.objects.read, self.objects.write)
        self.error_control = ErrorControl(self.objects, self._send_state, self.lose_master)
        self.pdo = PdoEngine(self.objects, self.send, self.fail)
        self._wire = wire
        self._bus = InProcessBus(wire, self._on_frame)

    @abstractmethod
    def live_objects(self) -> dict[Entry, Callable[[], int]]:
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
        """Load the communication settings of power on, announce the node, and become pre-operational."""
        self.nmt_state = NmtState.PRE_OPERATIONAL
        self.pdo.configure()
        self.send(0x700 + self.node_id, b"\0")
        self.error_control.start(self._clock.now_s())

    def enter(self, state: NmtState) -> None:
        """Change the NMT state."""
        if state is NmtState.OPERATIONAL and self.nmt_state is not NmtState.OPERATIONAL:
            self.pdo.start()
        self.nmt_state = state

    def send_due(self, now_s: float) -> None:
        """Send what is due."""
        self._wire.tick(now_s)
        if self.nmt_state is NmtState.OFF:
            return
        self.error_control.tick(now_s)
        if self.nmt_state is NmtState.OPERATIONAL:
            self.pdo.send_changes(now_s)

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
        self.error_control.mute = True

    def unplug(self) -> None:
        """Leave the bus silently; a moving shaft keeps moving."""
        self._bus.shutdown()

    def _send_state(self, toggle: int) -> None:
        self.send(0x700 + self.node_id, bytes([self.nmt_state | toggle]))

    def _on_write(self, entry: Entry, value: int, before: int) -> None:  # noqa: ARG002 - a drive needs them
        if entry in _WATCH_ENTRIES:
            self.error_control.configure(self._clock.now_s())
        elif entry in _PDO_ENTRIES:
            self.pdo.configure()

    def _on_frame(self, message: can.Message) -> None:
        if self._deaf or self.nmt_state is NmtState.OFF or message.is_extended_id or message.is_error_frame:
            return
        can_id = message.arbitration_id
        if message.is_remote_frame:
            self._on_remote(can_id)
        elif can_id == 0x600 + self.node_id:
            self.tick()
            self._on_sdo(bytes(message.data))
        elif can_id == 0x000:
            self._on_nmt(bytes(message.data))
        elif can_id >= 0x700:
            self.error_control.hear(can_id - 0x700, self._clock.now_s())
        elif self.nmt_state is NmtState.OPERATIONAL and self.pdo.listens_to(can_id):
            self.tick()
            self.pdo.take(can_id, bytes(message.data))

    def _on_remote(self, can_id: int) -> None:
        if can_id == 0x700 + self.node_id:
            self.error_control.guard(self._clock.now_s())
        elif self.nmt_state is NmtState.OPERATIONAL:
            self.tick()
            self.pdo.request(can_id)

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
            self.pdo.send_changes(self._clock.now_s())

    def _take_scripted_abort(self, request: bytes) -> bytes | None:
        if not self._aborts or len(request) != 8:
            return None
        code, index = self._aborts[0]
        asked = int.from_bytes(request[1:3], "little")
        if index not in {None, asked}:
            return None
        self._aborts.popleft()
        return b"\x80" + request[1:4] + code.to_bytes(4, "little")

    def _on_nmt(self, data: bytes) -> None:
        if len(data) == 2 and data[1] in {0, self.node_id}:
            self.tick()
            self._obey_nmt(data[0])
