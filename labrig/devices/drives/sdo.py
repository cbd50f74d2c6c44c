"""The client of CANopen's SDO protocol (CiA 301): one transfer at a time, with counted retries.

`canopen`'s own client does not retry, sends aborts, and accepts any answer that comes next. Here an answer
counts only if it names the requested object. Every request of labrig may be repeated: writing an object twice has no
further effect, and moves are absolute.
"""

import struct
from queue import SimpleQueue

from labrig.devices.bus import CanLink
from labrig.devices.drives.errors import describe_abort
from labrig.devices.drives.objects import Place
from labrig.errors import DriveRefusedError, DriveSilentError, Fault

NO_OBJECT = 0x06020000
"""Abort code of a node that does not have an object."""

_RETRIES = 1
"""How often a request without an answer is repeated."""

CHECK_POWER = "check power, CAN wiring, bit rate and node id of the drive"

_HEAD = struct.Struct("<BHB")
_ABORT = struct.Struct("<I")
_ABORTED = 0x80


class SdoClient:
    """Reads and writes objects of one node, each of at most four bytes.

    Parameters
    ----------
    link : CanLink
        The bus.
    node_id : int
        Its node id.
    name, axis : str
        The drive, for messages, and its axis.

    Attributes
    ----------
    retries : int
        Requests that had to be repeated.
    strays : int
        Unexpected answers: duplicated or late ones.
    """

    def __init__(self, link: CanLink, node_id: int, name: str, axis: str) -> None:
        self.retries = 0
        self.strays = 0
        self._name, self._axis = name, axis
        self._link = link
        self._request_id = 0x600 + node_id
        self._answers: SimpleQueue[bytes] = SimpleQueue()
        self._posted: list[bytes] = []
        link.network.subscribe(0x580 + node_id, lambda _id, data, _t: self._answers.put(bytes(data)))

    def upload(self, place: Place, what: str) -> bytes:
        """Return the bytes of an object, padded to four; `what` names it in messages.

        Raises `DriveRefusedError`, `DriveSilentError`, `BusError`.
        """
        return self._exchange(_HEAD.pack(0x40, *place) + bytes(4), what)[4:]

    def download(self, place: Place, data: bytes, what: str) -> None:
        """Write an object. Raises as `upload`."""
        self._exchange(_download_request(place, data), what)

    def post(self, place: Place, data: bytes) -> None:
        """Write an object without waiting for the answer, when every millisecond counts. Raises `BusError`."""
        request = _download_request(place, data)
        self._posted.append(request)
        self._link.send(self._request_id, request)

    def _exchange(self, request: bytes, what: str) -> bytes:
        for attempt in range(1 + _RETRIES):
            self.retries += attempt
            answer = self._ask(request)
            if answer is not None:
                break
        if answer is None:
            raise DriveSilentError(
                f"{self._name} did not answer within {self._link.answer_timeout_s:g} s, asked {1 + _RETRIES} times "
                f"({what})",
                CHECK_POWER,
                axis=self._axis,
            )
        if answer[0] == _ABORTED:
            code = _ABORT.unpack_from(answer, 4)[0]
            text = describe_abort(code)
            raise DriveRefusedError(
                f"{self._name} refused {what}: {text} (SDO abort 0x{code:08X})",
                "check rig file and drive settings against each other",
                fault=Fault("sdo-abort", code, 0, text),
            )
        return answer

    def _ask(self, request: bytes) -> bytes | None:
        while not self._answers.empty():
            self._drop(self._answers.get())
        deadline_s = self._link.clock.now_s() + self._link.answer_timeout_s
        self._link.send(self._request_id, request)
        while (answer := self._link.receive(self._answers, deadline_s)) is not None:
            if _answers(answer, request):
                return answer
            self._drop(answer)
        return None

    def _drop(self, answer: bytes) -> None:
        """Drop an unexpected answer: the answer to a post, or a stray one."""
        posted = next((request for request in self._posted if _answers(answer, request)), None)
        if posted is None:
            self.strays += 1
        else:
            self._posted.remove(posted)


def _download_request(place: Place, data: bytes) -> bytes:
    return _HEAD.pack(0x23 | (4 - len(data)) << 2, *place) + data.ljust(4, b"\0")


def _answers(answer: bytes, request: bytes) -> bool:
    """Tell whether an answer belongs to this request: same object, and a matching kind."""
    if len(answer) != 8 or answer[1:4] != request[1:4]:
        return False
    expected = 0x40 if request[0] == 0x40 else 0x60
    return answer[0] == _ABORTED or answer[0] & 0xE0 == expected
