"""The client of CANopen's SDO protocol (CiA 301): one transfer at a time for each node, with counted retries.

`canopen`'s own client has no lock, does not retry, and accepts any answer that comes next. Here an answer counts only
if it names the requested object. Every request of labrig may be repeated: writing an object twice has no further
effect, and moves are absolute.
"""

import struct
from queue import Empty, SimpleQueue
from threading import Lock

from labrig.devices.bus import CanLink

NO_OBJECT = 0x06020000
"""Abort code of a node that does not have an object."""

RETRIES = 1
"""How often a request without an answer is repeated."""

_HEAD = struct.Struct("<BHB")
_ABORT = struct.Struct("<I")
_ABORTED = 0x80


class SdoAbortedError(Exception):
    """The node refused a transfer.

    Parameters
    ----------
    code : int
        Why.
    """

    def __init__(self, code: int) -> None:
        super().__init__(f"0x{code:08X}")
        self.code = code


class SdoSilenceError(Exception):
    """The node did not answer, not even to a retry."""


class SdoClient:
    """Reads and writes objects of one node.

    Parameters
    ----------
    link : CanLink
        The bus.
    node_id : int
        Its node id.

    Attributes
    ----------
    retries : int
        Requests that had to be repeated.
    strays : int
        Unexpected answers: duplicated or late ones.
    """

    def __init__(self, link: CanLink, node_id: int) -> None:
        self.retries = 0
        self.strays = 0
        self._link = link
        self._request_id = 0x600 + node_id
        self._answers: SimpleQueue[bytes] = SimpleQueue()
        self._posted: list[bytes] = []
        self._lock = Lock()
        link.network.subscribe(0x580 + node_id, lambda _id, data, _t: self._answers.put(bytes(data)))

    def upload(self, index: int, subindex: int) -> bytes:
        """Read an object of at most four bytes; its bytes may be padded.

        Raises `SdoAbortedError`, `SdoSilenceError`, `BusError`.
        """
        return self._exchange(_HEAD.pack(0x40, index, subindex) + bytes(4))[4:]

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Write an object of at most four bytes. Raises as `upload`."""
        self._exchange(_download_request(index, subindex, data))

    def post(self, index: int, subindex: int, data: bytes) -> None:
        """Write an object without waiting for the answer, when every millisecond counts. Raises `BusError`."""
        request = _download_request(index, subindex, data)
        with self._lock:
            self._posted.append(request)
            self._link.send(self._request_id, request)

    def _exchange(self, request: bytes) -> bytes:
        with self._lock:
            for attempt in range(1 + RETRIES):
                self.retries += attempt
                answer = self._ask(request)
                if answer is not None:
                    return _refuse_abort(answer)
        raise SdoSilenceError

    def _ask(self, request: bytes) -> bytes | None:
        self._drop_strays()
        deadline_s = self._link.clock.now_s() + self._link.answer_timeout_s
        self._link.send(self._request_id, request)
        while (answer := self._link.receive(self._answers, deadline_s)) is not None:
            if _answers(answer, request):
                return answer
            self._drop(answer)
        return None

    def _drop_strays(self) -> None:
        try:
            while True:
                self._drop(self._answers.get_nowait())
        except Empty:
            return

    def _drop(self, answer: bytes) -> None:
        """Drop an unexpected answer: the answer to a post, or a stray one."""
        posted = next((request for request in self._posted if _answers(answer, request)), None)
        if posted is None:
            self.strays += 1
        else:
            self._posted.remove(posted)


def _download_request(index: int, subindex: int, data: bytes) -> bytes:
    return _HEAD.pack(0x23 | (4 - len(data)) << 2, index, subindex) + data.ljust(4, b"\0")


def _answers(answer: bytes, request: bytes) -> bool:
    """Tell whether an answer belongs to this request: same object, and a matching kind."""
    if len(answer) != 8 or answer[1:4] != request[1:4]:
        return False
    expected = 0x40 if request[0] == 0x40 else 0x60
    return answer[0] == _ABORTED or answer[0] & 0xE0 == expected


def _refuse_abort(answer: bytes) -> bytes:
    if answer[0] == _ABORTED:
        raise SdoAbortedError(_ABORT.unpack_from(answer, 4)[0])
    return answer
