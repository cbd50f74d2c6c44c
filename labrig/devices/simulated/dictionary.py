"""The object dictionary of a simulated drive, from its EDS file, and the SDO server in front of it (CiA 301).

Transfers are expedited: no object that labrig uses is longer than four bytes.
"""

import struct
from collections.abc import Callable, Mapping
from functools import partial

from canopen.objectdictionary import ODVariable
from canopen.sdo.exceptions import SdoAbortedError

from labrig.devices.drives import objects as co
from labrig.devices.drives.eds import count_bytes, find_bounds, find_default, read_own_eds
from labrig.devices.drives.model import Model
from labrig.devices.drives.objects import Place
from labrig.devices.drives.sdo import NO_OBJECT
from labrig.devices.simulated.shaft import HOMING_HERE, SEARCHES

MAPPINGS = {place: mapping for mapping in co.TPDO_MAPS for place in mapping}
"""An object that says what a transmit PDO carries -> all of that PDO, the number of its objects first."""

COMMAND_UNKNOWN = 0x05040001
READ_ONLY = 0x06010002
NOT_MAPPABLE = 0x06040041
PDO_LENGTH = 0x06040042
TOO_LONG = 0x06070012
TOO_SHORT = 0x06070013
NO_SUBINDEX = 0x06090011
OUT_OF_RANGE = 0x06090030
TOO_HIGH = 0x06090031
TOO_LOW = 0x06090032
MAXIMUM_BELOW_MINIMUM = 0x06090036
WRONG_STATE = 0x08000022
NMT_STATE = 0x0F00FFC0

_HEAD = struct.Struct("<BHB")
_CHOICES = {
    co.MODE: frozenset({co.PROFILE_POSITION, co.HOMING}),
    co.HOMING_METHOD: SEARCHES.keys() | HOMING_HERE,
}
"""Objects that take certain values only."""

_PROCESS_DATA = frozenset({co.CONTROLWORD, co.MODE, co.TARGET_POSITION, co.ERROR_COUNT})
"""Written all the time, so no part of the configuration that a fingerprint vouches for."""


class ObjectDictionary:
    """What clients read and write.

    Parameters
    ----------
    model : Model
        The product: what there is, and which objects are cleared when a setting changes.
    node_id : int
        Added to the COB-IDs that depend on it.
    fixed : mapping of Place to int
        What this drive has instead of the defaults, and keeps through every reset.
    live : mapping of Place to callable
        Objects whose value is made when it is read, as far as there are any; it is held within its range.

    Attributes
    ----------
    variables : mapping of Place to ODVariable
        The objects, with those that it lacks: motion needs them, and nobody can ask.
    refuse : callable
        Returns the abort code if an object cannot be written now, whatever the value.
    written : callable
        Told (place, value, value before) after each write.
    """

    refuse: Callable[[Place], int | None]
    written: Callable[[Place, int, int], None]

    def __init__(
        self, model: Model, node_id: int, fixed: Mapping[Place, int], live: Mapping[Place, Callable[[], int]]
    ) -> None:
        self._objects = model.eds.objects
        self.variables = {**read_own_eds("epos2.eds").objects, **self._objects}
        self._defaults = {p: find_default(v) + node_id * v.relative for p, v in self.variables.items()}
        self._fixed = dict(fixed)
        self._live: dict[Place, Callable[[], int]] = {
            place: partial(_clip, read, *find_bounds(self.variables[place]))
            for place, read in live.items()
            if place in self.variables
        }
        self._fingerprint = model.fingerprint
        self.values: dict[Place, int] = {}
        self.load()

    def load(self, *, only_communication: bool = False) -> None:
        """Take the values of power on, of all objects or of the communication profile alone (0x1000 to 0x1FFF)."""
        fresh = self._defaults | self._fixed
        if only_communication:
            kept = {co.ERROR_REGISTER, co.ERROR_COUNT, co.LAST_ERROR}
            fresh = {
                place: value for place, value in fresh.items() if place.index < 0x2000 and place not in kept
            }
        self.values |= fresh

    def set_fixed(self, place: Place, value: int) -> None:
        """Change what this drive is, behind its client's back."""
        self._fixed[place] = self.values[place] = value

    def value(self, place: Place) -> int:
        """Return the present value of an object."""
        live = self._live.get(place)
        return self.values[place] if live is None else live()

    def answer(self, request: bytes) -> bytes | None:
        """Return the response to an SDO request; None if the client expects none."""
        if len(request) != 8 or request[0] >> 5 == 4:
            return None
        command, *place = _HEAD.unpack_from(request)
        try:
            data = self._carry_out(command, Place(*place), request[4:])
        except SdoAbortedError as refusal:
            return _HEAD.pack(0x80, *place) + struct.pack("<I", refusal.code)
        answer = 0x60 if data is None else 0x43 | (4 - len(data)) << 2
        return _HEAD.pack(answer, *place) + (data or b"").ljust(4, b"\0")

    def _carry_out(self, command: int, place: Place, data: bytes) -> bytes | None:
        """Return what a request reads, or None after it has written."""
        if command >> 5 == 2:
            return self.read(place)
        if command >> 5 != 1 or not command & 0x02:
            raise SdoAbortedError(COMMAND_UNKNOWN)
        self.write(place, data[: 4 - (command >> 2 & 3) if command & 0x01 else len(self.read(place))])
        return None

    def read(self, place: Place) -> bytes:
        """Return the bytes of an object. Raises `SdoAbortedError`."""
        return self._require(place).encode_raw(self.value(place))

    def write(self, place: Place, data: bytes) -> None:
        """Write an object, after all checks. Raises `SdoAbortedError`."""
        variable = self._require(place)
        if not variable.writable:
            raise SdoAbortedError(READ_ONLY)
        if len(data) != count_bytes(variable):
            raise SdoAbortedError(TOO_LONG if len(data) > count_bytes(variable) else TOO_SHORT)
        value = int(variable.decode_raw(data))
        self._check(place, value, find_bounds(variable))
        self.put(place, value)

    def put(self, place: Place, value: int) -> None:
        """Set a value that has been checked, and tell who is concerned."""
        before, self.values[place] = self.values[place], value
        if place not in _PROCESS_DATA and place not in self._fingerprint and value != before:
            self.values |= dict.fromkeys(self._fingerprint, 0)
        self.written(place, value, before)

    def _require(self, place: Place) -> ODVariable:
        variable = self._objects.get(place)
        if variable is None:
            known = any(place.index == each.index for each in self._objects)
            raise SdoAbortedError(NO_SUBINDEX if known else NO_OBJECT)
        return variable

    def _check(self, place: Place, value: int, bounds: tuple[int, int]) -> None:
        if (code := self.refuse(place)) is not None:
            raise SdoAbortedError(code)
        low, high = bounds
        if not low <= value <= high:
            raise SdoAbortedError(TOO_LOW if value < low else TOO_HIGH)
        if value not in _CHOICES.get(place, {value}):
            raise SdoAbortedError(OUT_OF_RANGE)
        if place == co.ERROR_COUNT and value:
            raise SdoAbortedError(TOO_HIGH)
        if place in {co.LOWER_LIMIT, co.UPPER_LIMIT}:
            limits = self.values | {place: value}
            if limits[co.LOWER_LIMIT] > limits[co.UPPER_LIMIT]:
                raise SdoAbortedError(MAXIMUM_BELOW_MINIMUM)
        if place in MAPPINGS:
            self._check_mapping(place, value, MAPPINGS[place])

    def _check_mapping(self, place: Place, value: int, mapping: tuple[Place, ...]) -> None:
        if place.subindex == 0:
            if sum(self.values[entry] & 0xFF for entry in mapping[1 : value + 1]) > 64:
                raise SdoAbortedError(PDO_LENGTH)
        elif self.values[mapping[0]]:
            raise SdoAbortedError(WRONG_STATE)
        else:
            mapped = self._objects.get(Place(value >> 16, value >> 8 & 0xFF))
            if value and (mapped is None or mapped.index < 0x2000 or len(mapped) != value & 0xFF):
                raise SdoAbortedError(NOT_MAPPABLE)


def _clip(read: Callable[[], int], low: int, high: int) -> int:
    return max(low, min(high, read()))
