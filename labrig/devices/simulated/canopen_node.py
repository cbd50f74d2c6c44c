"""The CANopen side of a simulated drive (CiA 301): NMT, boot-up, SDO, PDO, EMCY, heartbeat, guarding, SYNC."""

import math
import struct
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
    {*co.RECEIVE_PDO_COB_IDS, *co.TRANSMIT_PDO_COB_IDS, *co.TPDO_TYPES, co.RESTORE_PDO_IDS}
)
_WATCH_ENTRIES = frozenset({co.CONSUMER_HEARTBEAT, co.CONSUMER_HEARTBEAT_2, co.PRODUCER_HEARTBEAT})


class NmtState(IntEnum):
    """State of a node, as in its heartbeat; OFF means no power or still booting."""

    OFF = -1
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class CanopenNode:
    """The CANopen node of a simulated drive; the folder of its kind holds what the drive does.

    Parameters
    ----------
    wire : InProcessWire
        The bus.
    node_id : int
        Its node id.
    clock : Clock
        Its time.
    table, fixed, live, written, is_powered
        As `ObjectDictionary` takes them.
    on_nmt : callable
        Called with each NMT command for this node.
    on_silence : callable
        Called with the instant at which a heartbeat was missed.
    on_pdo_error : callable
        Called with the error code when a PDO has the wrong length.
    before_frame : callable
        Called before each frame for this node.
    """

    def __init__(
        self,
        wire: InProcessWire,
        node_id: int,
        clock: Clock,
        *,
        table: ObjectTable,
        fixed: Mapping[Entry, int],
        live: Mapping[Entry, Callable[[], int]],
        written: Callable[[Entry, int, int], None],
        is_powered: Callable[[], bool],
        on_nmt: Callable[[int], None],
        on_silence: Callable[[float], None],
        on_pdo_error: Callable[[int], None],
        before_frame: Callable[[], None],
    ) -> None:
        self.node_id = node_id
        self.state = NmtState.OFF
        self._mute_frames: float = 0
        self._deaf = False
        self._aborts: deque[tuple[int, int | None]] = deque()
        self._ignored = 0
        self._clock = clock
        self._on_written = written
        self._on_nmt_command = on_nmt
        self._before_frame = before_frame
        self.objects = ObjectDictionary(
            table,
            node_id,
            fixed,
            live,
            self._on_write,
            is_powered=is_powered,
            is_pre_operational=lambda: self.state is NmtState.PRE_OPERATIONAL,
        )
        self._sdo = SdoServer(self.objects.read, self.objects.write)
        self.error_control = ErrorControl(self.objects, self._send_state, on_silence)
        self.pdo = PdoEngine(self.objects, self.send, on_pdo_error)
        self._wire = wire
        self._bus = InProcessBus(wire, self._on_frame)

    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame, unless this node is mute or off."""
        if self._mute_frames:
            self._mute_frames -= 1
        elif self.state is not NmtState.OFF:
            self._bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def send_emergency(self, code: int, register: int) -> None:
        """Send an EMCY frame; a stopped node sends none."""
        if self.state is not NmtState.STOPPED:
            self.send(0x080 + self.node_id, struct.pack("<HB5x", code, register))

    def boot(self) -> None:
        """Load the communication settings of power on, announce the node, and become pre-operational."""
        self.state = NmtState.PRE_OPERATIONAL
        self.pdo.configure()
        self.send(0x700 + self.node_id, b"\0")
        self.error_control.start(self._clock.now_s())

    def enter(self, state: NmtState) -> None:
        """Change the NMT state."""
        if state is NmtState.OPERATIONAL and self.state is not NmtState.OPERATIONAL:
            self.pdo.start()
        self.state = state

    def tick(self, now_s: float) -> None:
        """Send what is due."""
        self._wire.tick(now_s)
        if self.state is NmtState.OFF:
            return
        self.error_control.tick(now_s)
        if self.state is NmtState.OPERATIONAL:
            self.pdo.send_changes(now_s)

    def mute(self, frames: int | None) -> None:
        """Drop the next frames that this node sends, or all of them."""
        self._mute_frames = math.inf if frames is None else frames

    def deafen(self) -> None:
        """Receive nothing."""
        self._deaf = True

    def recover(self) -> None:
        """Receive and send again."""
        self._mute_frames, self._deaf = 0, False

    def abort_next(self, code: int, index: int | None) -> None:
        """Refuse the next SDO request, or the next one for an object, with an abort code."""
        self._aborts.append((code, index))

    def ignore_next(self, requests: int) -> None:
        """Ignore the next SDO requests."""
        self._ignored += requests

    def leave(self) -> None:
        """Leave the bus silently."""
        self._bus.shutdown()

    def _send_state(self, toggle: int) -> None:
        self.send(0x700 + self.node_id, bytes([self.state | toggle]))

    def _on_write(self, entry: Entry, value: int, before: int) -> None:
        if entry in _WATCH_ENTRIES:
            self.error_control.configure(self._clock.now_s())
        elif entry in _PDO_ENTRIES:
            self.pdo.configure()
        self._on_written(entry, value, before)

    def _on_frame(self, message: can.Message) -> None:
        if self._deaf or self.state is NmtState.OFF or message.is_extended_id or message.is_error_frame:
            return
        can_id = message.arbitration_id
        if message.is_remote_frame:
            self._on_remote(can_id)
        elif can_id == 0x600 + self.node_id:
            self._before_frame()
            self._on_sdo(bytes(message.data))
        elif can_id == 0x000:
            self._on_nmt(bytes(message.data))
        elif can_id >= 0x700:
            self.error_control.hear(can_id - 0x700, self._clock.now_s())
        elif self.state is NmtState.OPERATIONAL and can_id < 0x580:
            self._on_process_data(can_id, bytes(message.data))

    def _on_remote(self, can_id: int) -> None:
        if can_id == 0x700 + self.node_id:
            self.error_control.guard(self._clock.now_s())
        elif self.state is NmtState.OPERATIONAL:
            self._before_frame()
            self.pdo.request(can_id)

    def _on_sdo(self, request: bytes) -> None:
        if self.state is NmtState.STOPPED:
            return
        if self._ignored:
            self._ignored -= 1
            return
        response = self._scripted_abort(request) or self._sdo.answer(request)
        if response is not None:
            self.send(0x580 + self.node_id, response)
        if self.state is NmtState.OPERATIONAL:
            self.pdo.send_changes(self._clock.now_s())

    def _scripted_abort(self, request: bytes) -> bytes | None:
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
            self._before_frame()
            self._on_nmt_command(data[0])

    def _on_process_data(self, can_id: int, data: bytes) -> None:
        if can_id == self.objects.values[co.SYNC_ID] & 0x7FF:
            self._before_frame()
            self.pdo.sync()
        elif self.pdo.listens_to(can_id):
            self._before_frame()
            self.pdo.take(can_id, data)
