"""What a drive reports: statusword, position, motor current and inputs, in a frame at each SYNC, or else by SDO.

What is decided here
--------------------
- Statusword, position and motor current come at each SYNC in one process-data frame of 8 bytes, instead of six SDO
  frames; inputs that the rig file names, and what does not fit, in a second one. A missing report is requested by SDO
  and counted.
- Current and inputs are mapped while the node is pre-operational and without power, behind statusword and position,
  which stand there by default. If the drive refuses that, the mapping is as before; if it is another one, SDO does all
  of it. The mapping is not stored: it ends with the drive's power.
"""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cached_property, partial
from queue import SimpleQueue

from canopen.objectdictionary import ODVariable

from labrig.devices.bus import CanLink
from labrig.devices.drives import objects as co
from labrig.devices.drives.eds import make_form
from labrig.devices.drives.model import InputPlace
from labrig.devices.drives.node import NMT_PRE_OPERATIONAL, NMT_START, DriveNode
from labrig.devices.drives.objects import Place
from labrig.devices.input_channel import InputValue
from labrig.errors import DriveError, DriveRefusedError

_PDO_BITS = 64
_REPORTED = (co.STATUSWORD, co.POSITION_ACTUAL)
_AT_EACH_SYNC = 1
REPORT_PDO, _LOAD_PDO = 2, 3
"""Transmit PDO, counted from 0, that holds statusword and position by default, and one for what has no room there."""

_REPORT_PATIENCE = 0.25
"""Longest wait for a report, as a part of the answer timeout: its frame is already on its way."""

Layout = tuple[ODVariable, ...]
"""The objects that a PDO carries, in their order."""


def pack_into_pdos(variables: Iterable[ODVariable], pdos: Sequence[int]) -> dict[int, Layout]:
    """Return which PDO carries which objects: each goes into the first with room; those without room are left out."""
    layouts: dict[int, Layout] = {}
    for variable in variables:
        for pdo in pdos:
            carried = layouts.get(pdo, ())
            if sum(map(len, carried)) + len(variable) <= _PDO_BITS:
                layouts[pdo] = (*carried, variable)
                break
    return layouts


def mapping_of(variable: ODVariable) -> int:
    """Return the value by which a PDO's mapping names an object."""
    return variable.index << 16 | variable.subindex << 8 | len(variable)


class SyncedPdos:
    """The transmit PDOs of one drive that labrig listens to.

    Parameters
    ----------
    link : CanLink
        The bus.
    node_id : int
        Node id of the drive.
    pdos : sequence of int
        The PDOs, counted from 0.

    Attributes
    ----------
    switched_on : tuple of int
        Those that are switched on.
    missed, strays : int
        How many expected PDOs did not arrive, and how many came unexpected.
    """

    def __init__(self, link: CanLink, node_id: int, pdos: Sequence[int]) -> None:
        self.missed = self.strays = 0
        self._link = link
        self._is_awaited = False
        self._arrived: dict[int, SimpleQueue[bytes]] = {pdo: SimpleQueue() for pdo in pdos}
        self.listen({})
        for pdo, arrived in self._arrived.items():
            link.network.subscribe(0x180 + 0x100 * pdo + node_id, partial(_keep, arrived))

    def listen(self, layouts: Mapping[int, Layout]) -> None:
        """Take note of what each PDO carries from now on; those that are not named are switched off."""
        self.switched_on = tuple(layouts)
        self._carried = {
            pdo: (
                make_form(layout),
                tuple(Place(each.index, each.subindex) for each in layout),
            )
            for pdo, layout in layouts.items()
        }

    def expect(self) -> None:
        """Drop what has arrived: the next `take` returns what the drive sends at the coming SYNC."""
        self._is_awaited = bool(self.switched_on)
        for arrived in self._arrived.values():
            while not arrived.empty():
                arrived.get_nowait()
                self.strays += 1

    def take(self, patience_s: float) -> dict[Place, int]:
        """Return what was sent at the SYNC, without what has not arrived after `patience_s`; once after `expect`."""
        is_awaited, self._is_awaited = self._is_awaited, False
        if not is_awaited:
            return {}
        deadline_s, values = self._link.clock.now_s() + patience_s, dict[Place, int]()
        for pdo, (form, places) in self._carried.items():
            data = self._link.receive(self._arrived[pdo], deadline_s)
            if data is None or len(data) != form.size:
                self.missed += 1
            else:
                values |= zip(places, form.unpack(data), strict=True)
        return values


def _keep(arrived: SimpleQueue[bytes], _can_id: int, data: bytearray, _timestamp: float) -> None:
    arrived.put(bytes(data))


class DriveReports:
    """Reads what a drive reports.

    Parameters
    ----------
    node : DriveNode
        The drive.
    link : CanLink
        Its bus.
    """

    def __init__(self, node: DriveNode, link: CanLink) -> None:
        self._node = node
        self._answer_timeout_s = link.answer_timeout_s
        self.pdos = SyncedPdos(link, node.node_id, (REPORT_PDO, _LOAD_PDO))
        self._is_awaited = False

    def switch_on(self) -> None:
        """Make the drive report at each SYNC, as far as its PDOs can be mapped and switched on."""
        wanted = map(self._node.variable, (*_REPORTED, *self._list_load(with_current=True)))
        layouts: dict[int, Layout] = {}
        for pdo, layout in pack_into_pdos(wanted, (REPORT_PDO, _LOAD_PDO)).items():
            least = layout[: len(_REPORTED)] if pdo == REPORT_PDO else layout
            for tried in dict.fromkeys((len(layout), len(least))):
                if self._map(pdo, layout[:tried]) and self._send_at_sync(pdo):
                    layouts[pdo] = layout[:tried]
                    break
        self.pdos.listen(layouts)

    def _list_load(self, *, with_current: bool) -> tuple[Place, ...]:
        """Return the objects of motor current and inputs that are read, each once."""
        current = (self.current[0],) if self.current is not None and with_current else ()
        return (*current, *self._input_words)

    def _map(self, pdo: int, layout: Layout) -> bool:
        """Tell whether a PDO carries these objects; map them if it does not, and the first ones are there already."""
        mapping = co.TPDO_MAPS[pdo][: 1 + len(layout)]
        wanted = [len(layout), *map(mapping_of, layout)]
        found = [self._node.upload(place) for place in mapping if self._node.model.has(place)]
        if found == wanted:
            return True
        own = [len(_REPORTED), *wanted[1 : 1 + len(_REPORTED)]]
        if len(found) < len(wanted) or (pdo == REPORT_PDO and found[: len(own)] != own):
            return False
        cob_id = co.TRANSMIT_PDO_COB_IDS[pdo]
        self._node.send_nmt(NMT_PRE_OPERATIONAL)
        try:
            self._node.adjust({cob_id: self._node.upload(cob_id) | co.PDO_INVALID})
            self._write_mapping(mapping, wanted)
        except DriveRefusedError:
            with suppress(DriveRefusedError):
                self._write_mapping(mapping, found)
            return False
        finally:
            self._node.send_nmt(NMT_START)
        return True

    def _write_mapping(self, mapping: tuple[Place, ...], values: list[int]) -> None:
        """Write what a PDO carries; the number of objects is zero meanwhile."""
        self._node.ensure(mapping[0], 0)
        self._node.adjust(dict(zip(mapping[1:], values[1:], strict=True)))
        self._node.adjust({mapping[0]: values[0]})

    def _send_at_sync(self, pdo: int) -> bool:
        """Tell whether a PDO is sent at each SYNC from now on."""
        cob_id = co.NO_REMOTE | 0x180 + 0x100 * pdo + self._node.node_id
        try:
            self._node.adjust({co.TPDO_TYPES[pdo]: _AT_EACH_SYNC, co.TRANSMIT_PDO_COB_IDS[pdo]: cob_id})
        except DriveRefusedError:
            return False
        return True

    def expect(self) -> None:
        """Drop earlier reports: the next `read` is that of the coming SYNC."""
        self._is_awaited = True
        self.pdos.expect()

    def read(self) -> dict[Place, int]:
        """Return statusword, position [counts] and load, as reported; by SDO what is not expected or does not arrive.

        The motor current is only in a report that was expected: who looks in between asks for it if the axis lags.
        """
        values = self.pdos.take(_REPORT_PATIENCE * self._answer_timeout_s)
        with_current, self._is_awaited = self._is_awaited, False
        for place in (*_REPORTED, *self._list_load(with_current=with_current)):
            if place not in values:
                values[place] = self._node.upload(place)
        return values

    # Load

    @cached_property
    def current(self) -> tuple[Place, float] | None:
        """Object of the motor current and its unit [mA]; None without one.

        The torque 0x6077 is in thousandths of the rated torque, which the motor has at its rated current 0x6075.
        """
        return self._find_milliamperes(self._node.model.current_ma, (co.CURRENT_ACTUAL, co.TORQUE_ACTUAL))

    @cached_property
    def current_limit(self) -> tuple[Place, float] | None:
        """Object of the output current limit and its unit [mA]; None without one."""
        return self._find_milliamperes(self._node.model.current_limit_ma, (co.MAX_CURRENT,))

    def _find_milliamperes(self, own: Place | None, standard: Iterable[Place]) -> tuple[Place, float] | None:
        """Return the maker's object, in mA; else the first of the standard's, in thousandths of the rated current."""
        if own is not None:
            return own, 1.0
        found = next(filter(self._node.model.has, standard), None)
        rated_ma = self._node.find(co.RATED_CURRENT)
        return (found, rated_ma / 1000) if found is not None and rated_ma else None

    def convert_current(self, values: Mapping[Place, int]) -> float | None:
        """Return the motor current among reported values [mA]."""
        if self.current is None or self.current[0] not in values:
            return None
        return values[self.current[0]] * self.current[1]

    @cached_property
    def _input_places(self) -> dict[str, InputPlace]:
        """Where the inputs are read that its section names. Raises `DriveError` if the drive lacks or hides one."""
        return {
            name: self._find_input(name, channel.source)
            for name, channel in self._node.section.inputs.items()
        }

    @cached_property
    def _input_words(self) -> tuple[Place, ...]:
        """The objects that hold them, each once."""
        return tuple(dict.fromkeys(found.place for found in self._input_places.values()))

    def _find_input(self, name: str, source: str) -> InputPlace:
        model, bit = self._node.model, self._node.section.digital_inputs.get(source)
        if source in model.analog:
            return InputPlace(model.analog[source])
        if bit is None or not model.has(model.inputs):
            raise DriveError(
                f"{self._node.name} has no input {source}, which the rig file names {name}",
                "wire it to an input that the drive has, and name that one",
            )
        mask = -1 if model.input_mask is None else self._node.upload(model.input_mask)
        if not mask >> bit & 1:
            raise DriveError(
                f"{self._node.name} hides its input {source}, which would always read off: the mask "
                f"{model.input_mask} is {mask:#06x}, without bit {bit}",
                f"set bit {bit} of the mask in {model.tool} and save it, or use an input that the mask shows",
            )
        return InputPlace(model.inputs, bit)

    def read_inputs(self) -> dict[str, InputValue]:
        """Return what the inputs read that its section names."""
        return self.convert_inputs({place: self._node.upload(place) for place in self._input_words})

    def convert_inputs(self, values: Mapping[Place, int]) -> dict[str, InputValue]:
        """Return the inputs among read values, by their names."""
        channels = self._node.section.inputs
        return {
            name: channels[name].convert(values[found.place] / 1000)
            if found.bit is None
            else bool(values[found.place] >> found.bit & 1)
            for name, found in self._input_places.items()
        }
