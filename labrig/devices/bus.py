"""The CAN bus, real or inside the process. Both are a `CanLink`, and a user of the link cannot tell which it is.

Every frame is logged with its rig time, for the record. `BusNetwork.trouble` is the error of a bus that has failed:
error frames for error passive and bus off, or an adapter that can no longer be read. Interfaces that report neither
show the failure by the silence of the drives.
"""

import logging
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Any, TypeVar

import can
import canopen

from labrig.clock import Clock
from labrig.devices.can_description import CanDescription
from labrig.errors import BusError, BusOffError, BusPassiveError

_NOTIFIER_CYCLE_S = 0.1
"""How long closing may wait for python-can's thread."""

_LOOK_S = 0.01
"""On a bus inside the process, time passes only during a sleep; a late answer is polled at this interval."""

_MOST_FRAMES_KEPT = 200_000
"""Most frames that wait for the record; beyond that the oldest are dropped."""

# Classes of SocketCAN's error frames, and bits of their second byte (linux/can/error.h).
_ERROR_CONTROLLER, _ERROR_BUS_OFF, _ERROR_PASSIVE = 0x004, 0x040, 0x30

OPENING_FAILURES = (can.CanError, OSError, ValueError, ImportError, NameError, TypeError, AttributeError)
"""What python-can raises when the vendor's driver is missing differs by interface."""

_OPTIONS: dict[str, dict[str, Any]] = {"slcan": {"timeout": 0.05}}
"""Default options; without this one, python-can polls slcan a thousand times a second."""

_HINTS = {
    "socketcan": "plug in the adapter, then as root: ip link set {channel} up type can bitrate {bitrate}; ip link "
    "shows which interfaces there are",
    "slcan": "check can.channel in the rig file: the serial port of the adapter, such as /dev/ttyACM0; who may open "
    "it is in its group, often dialout",
}
"""Interface -> what to do if it cannot be opened."""

_OTHER_HINT = "check can.channel in the rig file, the adapter, and whether its driver is installed"

_T = TypeVar("_T")
_CHECK_BUS = "check adapter, cable, termination, power and bit rate"

# labrig raises what these libraries log; without a handler Python would also print it to stderr.
for _library in ("canopen", "can"):
    logging.getLogger(_library).addHandler(logging.NullHandler())


class BusNetwork(canopen.Network):
    """A network of `canopen` that logs frames and errors.

    Parameters
    ----------
    clock : Clock
        Gives the frames their time.
    """

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self.NOTIFIER_CYCLE = _NOTIFIER_CYCLE_S
        self.trouble: BusError | None = None
        self._clock = clock
        self._frames: deque[tuple[float, int, bytes, str]] = deque(maxlen=_MOST_FRAMES_KEPT)
        listeners: list[can.Listener] = [*self.listeners, _TroubleListener(self)]
        self.listeners = listeners  # type: ignore[assignment]

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Send and log a frame."""
        self._frames.append((self._clock.now_s(), can_id, data, "T"))
        super().send_message(can_id, data, remote)

    def notify(self, can_id: int, data: bytearray, timestamp: float) -> None:
        """Log a frame and pass it to its subscribers."""
        self._frames.append((self._clock.now_s(), can_id, bytes(data), "R"))
        for callback in self.subscribers.get(can_id, ()):
            callback(can_id, data, timestamp)

    def check(self) -> None:
        """Do nothing: `trouble` has the reason why receiving ended."""

    def take_error_frame(self, kind: int, data: bytes) -> None:
        """Take an error frame of SocketCAN."""
        if kind & _ERROR_BUS_OFF:
            self.trouble = BusOffError("the CAN bus is off: the adapter counted too many errors", _CHECK_BUS)
        elif kind & _ERROR_CONTROLLER and len(data) > 1 and data[1] & _ERROR_PASSIVE and not self.trouble:
            self.trouble = BusPassiveError("the CAN adapter is error passive: frames get lost", _CHECK_BUS)

    def take_frames(self) -> list[tuple[float, int, bytes, str]]:
        """Return the frames since the last call: rig time, COB-ID, data, and T or R for sent or received."""
        taken = []
        while self._frames:
            taken.append(self._frames.popleft())
        return taken


class _TroubleListener(can.Listener):
    """Takes error frames, and the error that ends python-can's reading thread."""

    def __init__(self, network: BusNetwork) -> None:
        self._network = network

    def on_message_received(self, msg: can.Message) -> None:
        if msg.is_error_frame:
            self._network.take_error_frame(msg.arbitration_id, bytes(msg.data))

    def on_error(self, exc: Exception) -> None:
        self._network.trouble = BusError(f"the CAN adapter is gone: {exc}", _CHECK_BUS)


@dataclass(frozen=True)
class CanLink:
    """A connected bus.

    Parameters
    ----------
    network : BusNetwork
        The bus.
    clock : Clock
        Rig time, which bounds waiting for answers.
    answer_timeout_s : float
        How long a drive may take to answer; a real drive took at most 13 ms in 30 000 answers.
    in_process : bool
        Whether waiting for an answer must let time pass.
    attend : callable
        Called at each answer, but not while none comes.
    """

    network: BusNetwork
    clock: Clock
    answer_timeout_s: float
    in_process: bool = False
    attend: Callable[[], None] = lambda: None

    @property
    def carries(self) -> bool:
        """Whether frames still pass: on a working bus, and on one that is only error passive."""
        return self.network.trouble is None or isinstance(self.network.trouble, BusPassiveError)

    def require_works(self) -> None:
        """Raise the `BusError` of a bus that has failed."""
        if self.network.trouble is not None:
            raise self.network.trouble

    def send(self, can_id: int, data: bytes) -> None:
        """Send one frame. Raises `BusError`."""
        if not self.carries:
            self.require_works()
        try:
            self.network.send_message(can_id, data)
        except (can.CanError, OSError) as error:
            self.network.trouble = BusError(f"the CAN bus took no frame: {error}", _CHECK_BUS)
            raise self.network.trouble from error

    def receive(self, answers: SimpleQueue[_T], deadline_s: float) -> _T | None:
        """Return the next of `answers`, waiting for it until the rig time `deadline_s`; None when none comes.

        Raises what `attend` raises: a `BusError`.
        """
        while True:
            left_s = deadline_s - self.clock.now_s()
            try:
                is_last_look = self.in_process or left_s <= 0
                answer = answers.get_nowait() if is_last_look else answers.get(timeout=left_s)
            except Empty:
                if left_s <= 0:
                    return None
                if self.in_process:
                    self.clock.sleep(_LOOK_S)
            else:
                self.attend()
                return answer

    def close(self) -> None:
        """Leave the bus; whoever opens it next is told if it did not close."""
        with suppress(can.CanError, OSError):
            self.network.disconnect()


def open_can(description: CanDescription, clock: Clock) -> CanLink:
    """Connect to a real CAN interface through python-can.

    Raises
    ------
    BusError
        When the interface is unknown, its driver is missing, or it cannot be reached.
    """
    network = BusNetwork(clock)
    where = f"{description.interface} {description.channel}".strip()
    try:
        network.connect(
            interface=description.interface,
            channel=description.channel or None,
            bitrate=description.bitrate,
            **(_OPTIONS.get(description.interface, {}) | description.options),
        )
    except OPENING_FAILURES as error:
        hint = _HINTS.get(description.interface, _OTHER_HINT)
        raise BusError(
            f"CAN interface {where} cannot be opened: {error}",
            hint.format(channel=description.channel or "can0", bitrate=description.bitrate),
        ) from error
    return CanLink(network, clock, description.answer_timeout_ms / 1000)
