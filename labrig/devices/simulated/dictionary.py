"""The object dictionary of a simulated drive, from its EDS file: values, access, ranges, and rules of PDO mappings."""

from collections.abc import Callable, Mapping

from canopen.objectdictionary import ODVariable

from labrig.devices.drives import objects as co
from labrig.devices.drives.eds import count_bytes, find_bounds, find_default, read_own_eds
from labrig.devices.drives.model import Model
from labrig.devices.drives.objects import Place
from labrig.devices.simulated import sdo_server
from labrig.devices.simulated.sdo_server import SdoAbortError

_DEVICE_NAME = Place(0x1008)
"""A string, and so in no table of numbers."""

MAPPINGS = {place: mapping for mapping in co.TPDO_MAPS for place in mapping}
"""An object that says what a transmit PDO carries -> all of that PDO, the number of its objects first."""

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
        Objects whose value is made when it is read.

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
        eds = model.eds
        self._name = eds.product_name.encode("ascii", "replace")
        self._objects = eds.objects
        self._indices = {place.index for place in eds.objects} | {_DEVICE_NAME.index}
        self.variables = {**read_own_eds("epos2.eds").objects, **eds.objects}
        self._defaults = {p: find_default(v) + node_id * v.relative for p, v in self.variables.items()}
        self._fixed = dict(fixed)
        self._live = live
        self._fingerprint = model.fingerprint
        self.values: dict[Place, int] = {}
        self.load()

    def load(self, *, only_communication: bool = False) -> None:
        """Take the values of power on, of all objects or of the communication profile alone (0x1000 to 0x1FFF)."""
        fresh = self._defaults | self._fixed
        if only_communication:
            kept = {co.ERROR_REGISTER, co.ERROR_COUNT, *co.ERROR_HISTORY}
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

    def read(self, place: Place) -> bytes:
        """Return the bytes of an object. Raises `SdoAbortError`."""
        if place == _DEVICE_NAME:
            return self._name
        variable = self._require(place)
        if not variable.readable:
            raise SdoAbortError(sdo_server.WRITE_ONLY)
        return variable.encode_raw(self.value(place))

    def write(self, place: Place, data: bytes) -> None:
        """Write an object, after all checks. Raises `SdoAbortError`."""
        variable = None if place == _DEVICE_NAME else self._require(place)
        if variable is None or not variable.writable:
            raise SdoAbortError(sdo_server.READ_ONLY)
        if len(data) != count_bytes(variable):
            longer = len(data) > count_bytes(variable)
            raise SdoAbortError(sdo_server.TOO_LONG if longer else sdo_server.TOO_SHORT)
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
            known = place.index in self._indices
            raise SdoAbortError(sdo_server.NO_SUBINDEX if known else sdo_server.NO_OBJECT)
        return variable

    def _check(self, place: Place, value: int, bounds: tuple[int, int]) -> None:
        if (code := self.refuse(place)) is not None:
            raise SdoAbortError(code)
        low, high = bounds
        if not low <= value <= high:
            raise SdoAbortError(sdo_server.TOO_LOW if value < low else sdo_server.TOO_HIGH)
        if place == co.ERROR_COUNT and value:
            raise SdoAbortError(sdo_server.TOO_HIGH)
        if place in {co.LOWER_LIMIT, co.UPPER_LIMIT}:
            limits = self.values | {place: value}
            if limits[co.LOWER_LIMIT] > limits[co.UPPER_LIMIT]:
                raise SdoAbortError(sdo_server.MAXIMUM_BELOW_MINIMUM)
        if place in MAPPINGS:
            self._check_mapping(place, value, MAPPINGS[place])

    def _check_mapping(self, place: Place, value: int, mapping: tuple[Place, ...]) -> None:
        if place.subindex == 0:
            if sum(self.values[entry] & 0xFF for entry in mapping[1 : value + 1]) > 64:
                raise SdoAbortError(sdo_server.PDO_LENGTH)
        elif self.values[mapping[0]]:
            raise SdoAbortError(sdo_server.WRONG_STATE)
        else:
            mapped = self._objects.get(Place(value >> 16, value >> 8 & 0xFF))
            if value and (mapped is None or mapped.index < 0x2000 or len(mapped) != value & 0xFF):
                raise SdoAbortError(sdo_server.NOT_MAPPABLE)
