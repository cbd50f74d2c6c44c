"""Process data of a simulated drive (CiA 301): what its PDOs carry, and when they are sent and taken."""

import struct
from collections.abc import Callable
from dataclasses import dataclass

from labrig.devices import canopen_objects as co
from labrig.devices.canopen_objects import Entry
from labrig.devices.simulated.dictionary import ObjectDictionary

_SYNCHRONOUS, _ON_REQUEST = 1, 253
_NO_REMOTE = 0x40000000
_WRONG_LENGTH_ERROR = 0x8210
_WATCH_EVERY_S = 0.001


@dataclass(frozen=True)
class _Content:
    """What a transmit PDO carries: its form, and where the values come from."""

    form: struct.Struct
    values: tuple[Callable[[], int], ...]

    def pack(self) -> bytes:
        """Return the present bytes."""
        return self.form.pack(*(value() for value in self.values))


class PdoEngine:
    """The four receive and four transmit PDOs of a node.

    Parameters
    ----------
    objects : ObjectDictionary
        Holds their COB-IDs, types and maps, and the mapped objects.
    send : callable
        Takes (COB-ID, data).
    fail : callable
        Called with the error code when a PDO has the wrong length.
    """

    def __init__(
        self, objects: ObjectDictionary, send: Callable[[int, bytes], None], fail: Callable[[int], None]
    ) -> None:
        self._objects = objects
        self._send = send
        self._fail = fail
        self._waiting: dict[int, bytes] = {}
        self._sent: dict[int, tuple[bytes, float]] = {}
        self._sync_id = 0
        self._receive_ids: dict[int, int] = {}
        self._request_ids: dict[int, int] = {}
        self._transmit_ids: dict[int, int] = {}
        self._synchronous: tuple[int, ...] = ()
        self._watched: tuple[int, ...] = ()
        self._mapped: dict[int, list[Entry]] = {}
        self._contents: dict[int, _Content] = {}
        self.configure()

    def configure(self) -> None:
        """Read COB-IDs and types from the object dictionary again."""
        self._forget_mappings()
        values = self._objects.values
        self._sync_id = values[co.SYNC_ID] & 0x7FF
        self._receive_ids = {
            values[entry] & 0x7FF: n
            for n, entry in enumerate(co.RECEIVE_PDO_COB_IDS)
            if _is_valid(values[entry])
        }
        valid = [n for n, entry in enumerate(co.TRANSMIT_PDO_COB_IDS) if _is_valid(values[entry])]
        self._transmit_ids = {n: values[co.TRANSMIT_PDO_COB_IDS[n]] & 0x7FF for n in valid}
        self._request_ids = {
            can_id: n
            for n, can_id in self._transmit_ids.items()
            if not values[co.TRANSMIT_PDO_COB_IDS[n]] & _NO_REMOTE
        }
        self._synchronous = tuple(n for n in valid if values[co.TPDO_TYPES[n]] == _SYNCHRONOUS)
        self._watched = tuple(n for n in valid if values[co.TPDO_TYPES[n]] not in {_SYNCHRONOUS, _ON_REQUEST})

    def start(self) -> None:
        """Start again, as on entering OPERATIONAL: PDOs that are sent on change are sent once.

        Mappings are read again: a node takes them only before.
        """
        self._forget_mappings()
        self._waiting.clear()
        self._sent.clear()

    def _forget_mappings(self) -> None:
        self._mapped.clear()
        self._contents.clear()

    def listens_to(self, can_id: int) -> bool:
        """Tell whether a frame is SYNC or one of our receive PDOs."""
        return can_id == self._sync_id or can_id in self._receive_ids

    def take(self, can_id: int, data: bytes) -> None:
        """Take SYNC or a receive PDO."""
        if can_id == self._sync_id:
            self._sync()
            return
        n = self._receive_ids[can_id]
        if len(data) < sum(entry.size for entry in self._find_mapped(co.RPDO_MAPS[n])):
            self._fail(_WRONG_LENGTH_ERROR)
        elif self._objects.values[co.RPDO_TYPES[n]] == _SYNCHRONOUS:
            self._waiting[n] = data
        else:
            self._apply(n, data)

    def request(self, can_id: int) -> None:
        """Answer a remote frame that asks for a transmit PDO which allows it."""
        n = self._request_ids.get(can_id)
        if n is not None:
            self._transmit(n)

    def _sync(self) -> None:
        """Apply what waited for SYNC, and send what is due at SYNC."""
        waiting, self._waiting = self._waiting, {}
        for n, data in waiting.items():
            self._apply(n, data)
        for n in self._synchronous:
            self._transmit(n)

    def send_changes(self, now_s: float) -> None:
        """Send the PDOs whose content has changed, once their inhibit time is over."""
        for n in self._watched:
            last, sent_s = self._sent.get(n, (b"", -1e9))
            inhibit_s = max(_WATCH_EVERY_S, self._objects.values[co.TPDO_INHIBITS[n]] * 1e-4)
            if now_s - sent_s < inhibit_s and last:
                continue
            data = self._pack_content(n)
            if data != last:
                self._sent[n] = (data, now_s)
                self._transmit(n)

    def _transmit(self, n: int) -> None:
        self._send(self._transmit_ids[n], self._pack_content(n))

    def _pack_content(self, n: int) -> bytes:
        content = self._contents.get(n)
        if content is None:
            mapped = self._find_mapped(co.TPDO_MAPS[n])
            form = struct.Struct("<" + "".join(entry.code for entry in mapped))
            content = self._contents[n] = _Content(form, tuple(map(self._objects.find_source, mapped)))
        return content.pack()

    def _find_mapped(self, mapping: tuple[Entry, ...]) -> list[Entry]:
        known = self._mapped.get(mapping[0].index)
        if known is not None:
            return known
        values = self._objects.values
        places = [values[place] for place in mapping[1 : values[mapping[0]] + 1]]
        found = [self._objects.find(place >> 16, place >> 8 & 0xFF) for place in places]
        self._mapped[mapping[0].index] = [entry for entry in found if entry is not None]
        return self._mapped[mapping[0].index]

    def _apply(self, n: int, data: bytes) -> None:
        start = 0
        for entry in self._find_mapped(co.RPDO_MAPS[n]):
            self._objects.put_checked(entry, data[start : start + entry.size])
            start += entry.size


def _is_valid(cob_id: int) -> bool:
    return not cob_id & co.PDO_INVALID
