"""The object dictionary of a simulated EPOS2: values, access, ranges, storing and restoring."""

from collections.abc import Callable, Mapping

from labrig.devices import epos2_objects as od
from labrig.devices.simulated import sdo_server
from labrig.devices.simulated.sdo_server import SdoAbortError

_ENTRIES = {(entry.index, entry.subindex): entry for entry in od.NUMBERS}
_INDICES = {entry.index for entry in od.NUMBERS} | {od.DEVICE_NAME[0]}
_HIGHEST_SUBINDEX = {index: max(sub for i, sub in _ENTRIES if i == index) for index, _ in _ENTRIES}

_SAVE, _LOAD = 0x65766173, 0x64616F6C
_SIGNATURES = {od.STORE: _SAVE, od.RESTORE: _LOAD, od.RESTORE_PDO_IDS: _LOAD}
_COB_IDS = (*od.RECEIVE_PDO_COB_IDS, *od.TRANSMIT_PDO_COB_IDS)
_PDO_MAPS = (*od.RPDO_MAPS, *od.TPDO_MAPS)
_MAP_ENTRIES = {entry: mapping for mapping in _PDO_MAPS for entry in mapping}
_PDO_TYPES = frozenset({*od.RPDO_TYPES, *od.TPDO_TYPES})
_TRANSMISSION_TYPES = frozenset({1, 253, 255})
_WHILE_UNPOWERED = frozenset(
    {*_SIGNATURES, od.ENCODER_PULSES, od.SENSOR_TYPE, od.SENSOR_POLARITY, od.MOTOR_TYPE, od.POLE_PAIRS}
)
_PROCESS_DATA = frozenset(
    {od.CONTROLWORD, od.MODE, od.TARGET_POSITION, od.TARGET_VELOCITY, od.ERROR_COUNT, *_SIGNATURES}
)
"""Written all the time, so neither stored nor part of the configuration that 0x1020 vouches for."""

_FINGERPRINT = (od.CONFIGURATION_DATE, od.CONFIGURATION_TIME)
_LIMITS = {od.LOWER_LIMIT: od.UPPER_LIMIT, od.UPPER_LIMIT: od.LOWER_LIMIT}
_RESERVED_IDS = (range(0x80), range(0x101, 0x180), range(0x581, 0x800))


class ObjectDictionary:
    """What clients read and write.

    Parameters
    ----------
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
        node_id: int,
        fixed: Mapping[od.Entry, int],
        live: Mapping[od.Entry, Callable[[], int]],
        written: Callable[[od.Entry, int, int], None],
        *,
        is_powered: Callable[[], bool],
        is_pre_operational: Callable[[], bool],
    ) -> None:
        based = {entry: entry.default + node_id for entry in (*_COB_IDS, *_ids_with_node())}
        self._defaults = {entry: entry.default for entry in od.NUMBERS} | based | {od.NODE_ID: node_id}
        self._fixed = dict(fixed)
        self._live = live
        self._written = written
        self._is_powered = is_powered
        self._is_pre_operational = is_pre_operational
        self._stored: dict[od.Entry, int] = {}
        self.values: dict[od.Entry, int] = {}
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

    def set_fixed(self, entry: od.Entry, value: int) -> None:
        """Change what this drive is, behind its client's back."""
        self._fixed[entry] = self.values[entry] = value
        self._stored.pop(entry, None)

    def value(self, entry: od.Entry) -> int:
        """Return the present value of an entry."""
        live = self._live.get(entry)
        return self.values[entry] if live is None else live()

    def read(self, index: int, subindex: int) -> bytes:
        """Return the bytes of an object. Raises `SdoAbortError`."""
        if (index, subindex) == od.DEVICE_NAME:
            return b"EPOS2"
        entry = _ENTRIES.get((index, subindex))
        if entry is not None:
            return entry.pack(self.value(entry))
        if subindex == 0 and _HIGHEST_SUBINDEX.get(index, 0):
            return bytes([_HIGHEST_SUBINDEX[index]])
        raise _missing(index)

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """Write an object, after all checks. Raises `SdoAbortError`."""
        entry = find_entry(index, subindex)
        if entry is None:
            known = (index, subindex) == od.DEVICE_NAME or (subindex == 0 and index in _HIGHEST_SUBINDEX)
            raise SdoAbortError(sdo_server.READ_ONLY) if known else _missing(index)
        if entry.access == "ro":
            raise SdoAbortError(sdo_server.READ_ONLY)
        if len(data) != entry.size:
            raise SdoAbortError(sdo_server.LENGTH)
        value = entry.unpack(data)
        self._check(entry, value)
        self.put(entry, value)

    def put_checked(self, entry: od.Entry, data: bytes) -> None:
        """Write what a PDO brought; a value that is refused is dropped, for nobody can be told."""
        try:
            self.write(entry.index, entry.subindex, data)
        except SdoAbortError:
            return

    def put(self, entry: od.Entry, value: int) -> None:
        """Set a value that has been checked, and tell who is concerned."""
        before = self.values[entry]
        if entry in _SIGNATURES:
            self._store_or_restore(entry)
        else:
            self.values[entry] = value
        if entry not in _PROCESS_DATA and entry not in _FINGERPRINT and value != before:
            self.values |= dict.fromkeys(_FINGERPRINT, 0)
        self._written(entry, value, before)

    def _check(self, entry: od.Entry, value: int) -> None:
        if entry in _WHILE_UNPOWERED and self._is_powered():
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

    def _check_limits(self, entry: od.Entry, value: int) -> None:
        other = self.values[_LIMITS[entry]]
        low, high = (value, other) if entry is od.LOWER_LIMIT else (other, value)
        if low > high:
            raise SdoAbortError(sdo_server.MAXIMUM_BELOW_MINIMUM)

    def _check_mapping(self, entry: od.Entry, value: int) -> None:
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
            self._check_mappable(value, receive=mapping in od.RPDO_MAPS)

    @staticmethod
    def _check_mappable(value: int, *, receive: bool) -> None:
        mapped = find_entry(value >> 16, value >> 8 & 0xFF)
        if mapped is None or mapped.index < 0x2000 or (receive and mapped.access == "ro"):
            raise SdoAbortError(sdo_server.NOT_MAPPABLE)
        if 8 * mapped.size != value & 0xFF:
            raise SdoAbortError(sdo_server.NOT_MAPPABLE)

    def _store_or_restore(self, entry: od.Entry) -> None:
        if entry is od.STORE:
            self._stored = {
                e: self.values[e] for e in od.NUMBERS if e.access == "rw" and e not in _PROCESS_DATA
            }
        elif entry is od.RESTORE:
            self._stored = {}
        else:
            self.values |= {cob_id: self._defaults[cob_id] for cob_id in _COB_IDS}


def _ids_with_node() -> tuple[od.Entry, ...]:
    return (od.EMERGENCY_ID, od.SDO_REQUEST_ID, od.SDO_RESPONSE_ID)


def find_entry(index: int, subindex: int) -> od.Entry | None:
    """Return the numeric entry at a place, or None."""
    return _ENTRIES.get((index, subindex))


def _missing(index: int) -> SdoAbortError:
    return SdoAbortError(sdo_server.NO_SUBINDEX if index in _INDICES else sdo_server.NO_OBJECT)
