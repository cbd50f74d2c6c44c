"""Process data of a simulated drive (CiA 301): what its PDOs carry, and when they are sent and taken."""

from collections.abc import Callable
from contextlib import suppress
from struct import Struct

from labrig.devices.drives import objects as co
from labrig.devices.drives.eds import count_bytes, make_form
from labrig.devices.drives.objects import Place
from labrig.devices.simulated.dictionary import ObjectDictionary
from labrig.devices.simulated.sdo_server import SdoAbortError

_LAST_SYNCHRONOUS = 240
_WRONG_LENGTH_ERROR = 0x8210


class PdoEngine:
    """The four receive and four transmit PDOs of a node: taken at once, and sent at SYNC or when they change.

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
        self.configure()

    def configure(self) -> None:
        """Read COB-IDs, types and mappings again, as on entering OPERATIONAL: all that send on change are sent once."""
        values = self._objects.values
        self._sync_id = values[co.SYNC_ID] & 0x7FF
        received, sent = self._valid(co.RECEIVE_PDO_COB_IDS), self._valid(co.TRANSMIT_PDO_COB_IDS)
        self._received = {can_id: self._find_mapped(co.RPDO_MAPS[n]) for n, can_id in received.items()}
        self._contents = {can_id: self._find_mapped(co.TPDO_MAPS[n]) for n, can_id in sent.items()}
        at_sync = {n for n in sent if values[co.TPDO_TYPES[n]] <= _LAST_SYNCHRONOUS}
        self._at_sync = tuple(sent[n] for n in at_sync)
        self._last: dict[int, bytes] = {can_id: b"" for n, can_id in sent.items() if n not in at_sync}

    def _valid(self, places: tuple[Place, ...]) -> dict[int, int]:
        """Return number -> COB-ID of the PDOs that are not switched off."""
        values = [self._objects.values[place] for place in places]
        return {n: value & 0x7FF for n, value in enumerate(values) if not value & co.PDO_INVALID}

    def _find_mapped(self, mapping: tuple[Place, ...]) -> tuple[Struct, tuple[Place, ...]]:
        """Return form and objects of a PDO."""
        values = self._objects.values
        codes = [values[place] for place in mapping[1 : values[mapping[0]] + 1]]
        places = tuple(Place(code >> 16, code >> 8 & 0xFF) for code in codes)
        found = [(place, self._objects.find(place)) for place in places]
        known = [(place, variable) for place, variable in found if variable is not None]
        return make_form(variable for _, variable in known), tuple(place for place, _ in known)

    def listens_to(self, can_id: int) -> bool:
        """Tell whether a frame is SYNC or one of our receive PDOs."""
        return can_id == self._sync_id or can_id in self._received

    def take(self, can_id: int, data: bytes) -> None:
        """Take SYNC or a receive PDO."""
        if can_id == self._sync_id:
            for sent_id in self._at_sync:
                self._send(sent_id, self._pack(sent_id))
            return
        form, places = self._received[can_id]
        if len(data) < form.size:
            self._fail(_WRONG_LENGTH_ERROR)
            return
        start = 0
        for place in places:
            variable = self._objects.find(place)
            size = 0 if variable is None else count_bytes(variable)
            with suppress(SdoAbortError):  # nobody can be told
                self._objects.write(place, data[start : start + size])
            start += size

    def send_changes(self) -> None:
        """Send the PDOs whose content has changed."""
        for can_id, last in self._last.items():
            data = self._pack(can_id)
            if data != last:
                self._last[can_id] = data
                self._send(can_id, data)

    def _pack(self, can_id: int) -> bytes:
        form, places = self._contents[can_id]
        return form.pack(*map(self._objects.value, places))
