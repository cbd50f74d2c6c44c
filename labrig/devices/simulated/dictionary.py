"""The object dictionary of a simulated drive: values, access, ranges, storing and restoring."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from labrig.devices import canopen_objects as co
from labrig.devices.canopen_objects import Entry
from labrig.devices.simulated import sdo_server
from labrig.devices.simulated.sdo_server import SdoAbortError

_SAVE, _LOAD = 0x65766173, 0x64616F6C
_SIGNATURES = {co.STORE: _SAVE, co.RESTORE: _LOAD, co.RESTORE_PDO_IDS: _LOAD}
_COB_IDS = (*co.RECEIVE_PDO_COB_IDS, *co.TRANSMIT_PDO_COB_IDS)
_PDO_MAPS = (*co.RPDO_MAPS, *co.TPDO_MAPS)
_MAP_ENTRIES = {entry: mapping for mapping in _PDO_MAPS for entry in mapping}
_PDO_TYPES = frozenset({*co.RPDO_TYPES, *co.TPDO_TYPES})
_TRANSMISSION_TYPES = frozenset({1, 253, 255})
_PROCESS_DATA = frozenset(
    {co.CONTROLWORD, co.MODE, co.TARGET_POSITION, co.TARGET_VELOCITY, co.ERROR_COUNT, *_SIGNATURES}
)
"""Written all the time, so neither stored nor part of the configuration that a fingerprint vouches for."""

_DEVICE_NAME = (0x1008, 0)
"""Index and subindex of the device's name, a string and so not an `Entry`."""


_LIMITS = {co.LOWER_LIMIT: co.UPPER_LIMIT, co.UPPER_LIMIT: co.LOWER_LIMIT}
_RESERVED_IDS = (range(0x80), range(0x101, 0x180), range(0x581, 0x800))


@dataclass(frozen=True)
class ObjectTable:
    """The objects that a kind of drive has.

    Parameters
    ----------
    device_name : bytes
        What it says of itself (0x1008).
    entries : tuple of Entry
        Every numeric one, with the defaults and ranges of this kind.
    while_unpowered : frozenset of Entry
        Those that can be written only without power.
    fingerprint : tuple of Entry
        Those that are cleared when a setting changes.
    """

    device_name: bytes
    entries: tuple[Entry, ...]
    while_unpowered: frozenset[Entry] = frozenset()
    fingerprint: tuple[Entry, ...] = ()


class ObjectDictionary:
    """What clients read and write.

    Parameters
    ----------
    table : ObjectTable
        What there is.
    node_id : int
        Added to the COB-IDs that depend on it.
    fixed : mapping of Entry to int
        What this drive has instead of the defaults, and keeps through every reset.
    live : mapping of Entry to callable
        Entries whose value is made when it is read.
    written : callable
        Told (entry, value, value before) after each write.
    is_powered, is_pre_operational : callable
        Some objects can be written only without power, others only in this NMT state.
    """

    def __init__(
        self,
        table: ObjectTable,
        node_id: int,
        fixed: Mapping[Entry, int],
        live: Mapping[Entry, Callable[[], int]],
        written: Callable[[Entry, int, int], None],
        *,
        is_powered: Callable[[], bool],
        is_pre_operational: Callable[[], bool],
    ) -> None:
        self._table = table
        self._entries = {(entry.index, entry.subindex): entry for entry in table.entries}
        self._highest_subindex = dict(sorted(self._entries))  # of one index the last counts
        self._while_unpowered = table.while_unpowered | frozenset(_SIGNATURES)
        with_node = frozenset((*_COB_IDS, co.EMERGENCY_ID, co.SDO_REQUEST_ID, co.SDO_RESPONSE_ID))
        # What this drive lacks has the standard's defaults behind the scenes: motion needs them, and nobody can ask.
        own = frozenset(table.entries)
        every = (*(e for e in co.STANDARD if e not in own), *table.entries)
        self._defaults = {e: e.default + node_id * (e in with_node) for e in every}
        self._fixed = dict(fixed)
        self._live = live
        self._written = written
        self._is_powered = is_powered
        self._is_pre_operational = is_pre_operational
        self._stored: dict[Entry, int] = {}
        self.values: dict[Entry, int] = {}
        self.load()

    def load(self) -> None:
        """Take the values of power on: stored ones where there are some."""
        self.values = self._defaults | self._fixed | self._stored

    def load_communication(self) -> None:
        """Take the power-on values of the communication profile alone (0x1000 to 0x1FFF)."""
        fresh = self._defaults | self._fixed | self._stored
        self.values |= {
            e: v for e, v in fresh.items() if e.index < 0x2000 and e.index not in {0x1001, 0x1003}
        }

    def set_fixed(self, entry: Entry, value: int) -> None:
        """Change what this drive is, behind its client's back."""
        self._fixed[entry] = self.values[entry] = value
        self._stored.pop(entry, None)

    def value(self, entry: Entry) -> int:
        """Return the present value of an entry."""
        live = self._live.get(entry)
        return self.values[entry] if live is None else live()

    def find_source(self, entry: Entry) -> Callable[[], int]:
        """Return what gives the present value of an entry whenever it is called."""
        return self._live.get(entry, lambda: self.values[entry])

    def read(self, index: int, subindex: int) -> bytes:
        """Return the bytes of an object. Raises `SdoAbortError`."""
        if (index, subindex) == _DEVICE_NAME:
            return self._table.device_name
        entry = self.find(index, subindex)
        if entry is not None:
            if entry.access == "wo":
                raise SdoAbortError(sdo_server.WRITE_ONLY)
            return entry.pack(self.value(entry))
        if subindex == 0 and self._highest_subindex.get(index, 0):
            return bytes([self._highest_subindex[index]])
        raise self._make_missing_error(index)

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """Write an object, after all checks. Raises `SdoAbortError`."""
        entry = self.find(index, subindex)
        if entry is None:
            known = (index, subindex) == _DEVICE_NAME or (subindex == 0 and index in self._highest_subindex)
            raise SdoAbortError(sdo_server.READ_ONLY) if known else self._make_missing_error(index)
        if entry.access == "ro":
            raise SdoAbortError(sdo_server.READ_ONLY)
        if len(data) != entry.size:
            raise SdoAbortError(sdo_server.TOO_LONG if len(data) > entry.size else sdo_server.TOO_SHORT)
        value = entry.unpack(data)
        self._check(entry, value)
        self.put(entry, value)

    def put_checked(self, entry: Entry, data: bytes) -> None:
        """Write what a PDO brought; a value that is refused is dropped, for nobody can be told."""
        try:
            self.write(entry.index, entry.subindex, data)
        except SdoAbortError:
            return

    def put(self, entry: Entry, value: int) -> None:
        """Set a value that has been checked, and tell who is concerned."""
        before = self.values[entry]
        if entry in _SIGNATURES:
            self._store_or_restore(entry)
        else:
            self.values[entry] = value
        if entry not in _PROCESS_DATA and entry not in self._table.fingerprint and value != before:
            self.values |= dict.fromkeys(self._table.fingerprint, 0)
        self._written(entry, value, before)

    def _check(self, entry: Entry, value: int) -> None:
        if entry in self._while_unpowered and self._is_powered():
            raise SdoAbortError(sdo_server.WRONG_STATE)
        if entry.lowest is not None and value < entry.lowest:
            raise SdoAbortError(sdo_server.TOO_LOW)
        if entry.highest is not None and value > entry.highest:
            raise SdoAbortError(sdo_server.TOO_HIGH)
        if entry in _SIGNATURES and value != _SIGNATURES[entry]:
            raise SdoAbortError(sdo_server.NOT_STORED)
        if entry in _PDO_TYPES and value not in _TRANSMISSION_TYPES:
            raise SdoAbortError(sdo_server.OUT_OF_RANGE)
        if entry in _COB_IDS and any((value & 0x7FF) in reserved for reserved in _RESERVED_IDS):
            raise SdoAbortError(sdo_server.CAN_ID)
        if entry in _LIMITS:
            self._check_limits(entry, value)
        if entry in _MAP_ENTRIES:
            self._check_mapping(entry, value)

    def _check_limits(self, entry: Entry, value: int) -> None:
        other = self.values[_LIMITS[entry]]
        low, high = (value, other) if entry == co.LOWER_LIMIT else (other, value)
        if low > high:
            raise SdoAbortError(sdo_server.MAXIMUM_BELOW_MINIMUM)

    def _check_mapping(self, entry: Entry, value: int) -> None:
        if not self._is_pre_operational():
            raise SdoAbortError(sdo_server.NMT_STATE)
        mapping = _MAP_ENTRIES[entry]
        if entry.subindex == 0:
            bits = sum(self.values[place] & 0xFF for place in mapping[1 : value + 1])
            if bits > 64:
                raise SdoAbortError(sdo_server.PDO_LENGTH)
            return
        if self.values[mapping[0]]:
            raise SdoAbortError(sdo_server.WRONG_STATE)
        if value:
            self._check_mappable(value, receive=mapping in co.RPDO_MAPS)

    def _check_mappable(self, value: int, *, receive: bool) -> None:
        mapped = self.find(value >> 16, value >> 8 & 0xFF)
        if mapped is None or mapped.index < 0x2000 or (receive and mapped.access == "ro"):
            raise SdoAbortError(sdo_server.NOT_MAPPABLE)
        if 8 * mapped.size != value & 0xFF:
            raise SdoAbortError(sdo_server.NOT_MAPPABLE)

    def find(self, index: int, subindex: int) -> Entry | None:
        """Return the numeric entry at a place, or None."""
        return self._entries.get((index, subindex))

    def _make_missing_error(self, index: int) -> SdoAbortError:
        known = index in self._highest_subindex or index == _DEVICE_NAME[0]
        return SdoAbortError(sdo_server.NO_SUBINDEX if known else sdo_server.NO_OBJECT)

    def _store_or_restore(self, entry: Entry) -> None:
        if entry == co.STORE:
            self._stored = {
                e: self.values[e] for e in self._table.entries if e.access == "rw" and e not in _PROCESS_DATA
            }
        elif entry == co.RESTORE:
            self._stored = {}
        else:
            self.values |= {cob_id: self._defaults[cob_id] for cob_id in _COB_IDS}
