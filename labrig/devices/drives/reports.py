"""What a drive reports: statusword, position, motor current and inputs, in a frame at each SYNC, or else by SDO.

What is decided here
--------------------
- Statusword, position and, where it fits, the motor current come at each SYNC in one process-data frame of 8 bytes,
  instead of six SDO frames. A missing report is requested by SDO and counted. The inputs that a rig file names are read
  by SDO.
- The frame is mapped while the node is pre-operational and without power. If the drive refuses that, it is off, and all
  is read by SDO. The mapping is not stored: it ends with the drive's power.
"""

import math
from collections.abc import Callable, Iterable
from functools import cached_property
from queue import SimpleQueue
from struct import Struct

from labrig.devices.bus import CanLink
from labrig.devices.drives import objects as co
from labrig.devices.drives.eds import make_form
from labrig.devices.drives.node import NMT_PRE_OPERATIONAL, NMT_START, DriveNode
from labrig.devices.drives.objects import Place
from labrig.devices.input_channel import InputChannel, InputValue
from labrig.errors import DriveError, DriveRefusedError

_PDO_BITS = 64
_REPORTED = (co.STATUSWORD, co.POSITION_ACTUAL)
_AT_EACH_SYNC = 1

_REPORT_PATIENCE = 0.25
"""Longest wait for a report, as a part of the answer timeout: its frame is already on its way."""


_Input = tuple[Place, Callable[[int], InputValue]]
"""The object that holds an input, and what its value means."""


class DriveReports:
    """Reads what a drive reports.

    Parameters
    ----------
    node : DriveNode
        The drive.
    link : CanLink
        Its bus.

    Attributes
    ----------
    layout : tuple of Place
        What is reported at each SYNC; nothing if the drive refuses to.
    missed, strays : int
        How many expected PDOs did not arrive, and how many came unexpected.
    """

    def __init__(self, node: DriveNode, link: CanLink) -> None:
        self.missed = self.strays = 0
        self.layout: tuple[Place, ...] = ()
        self._form = Struct("")
        self._node = node
        self._link = link
        self._arrived: SimpleQueue[tuple[float, bytes]] = SimpleQueue()
        self._can_id = 0x180 + 0x100 * co.REPORT + node.node_id
        link.network.subscribe(self._can_id, self._on_report)

    def switch_on(self) -> None:
        """Make the drive report at each SYNC, if its PDO can be mapped and switched on."""
        places = (*_REPORTED, self._current[0]) if self._current is not None else _REPORTED
        fits = sum(len(self._node.variables[place]) for place in places) <= _PDO_BITS
        wanted = places if fits else _REPORTED
        self.layout = wanted if self._send_at_sync(wanted) else ()
        self._form = make_form([self._node.variables[place] for place in self.layout])

    def _send_at_sync(self, layout: tuple[Place, ...]) -> bool:
        """Tell whether these objects are sent at each SYNC from now on; what the drive refuses is off."""
        node, cob_id, mapping = self._node, co.REPORT_COB_ID, co.TPDO_MAPS[co.REPORT][: 1 + len(layout)]
        if not all(map(node.model.has, (cob_id, co.TPDO_TYPES[co.REPORT], *mapping))):
            return False
        carried = [place.index << 16 | place.subindex << 8 | len(node.variables[place]) for place in layout]
        wanted = dict(zip(mapping, (len(layout), *carried), strict=True))
        node.send_nmt(NMT_PRE_OPERATIONAL)
        try:
            if any(node.upload(place) != value for place, value in wanted.items()):
                node.adjust({cob_id: node.upload(cob_id) | co.PDO_INVALID, mapping[0]: 0})
                node.adjust({**dict(zip(mapping[1:], carried, strict=True)), mapping[0]: len(layout)})
            node.adjust({co.TPDO_TYPES[co.REPORT]: _AT_EACH_SYNC, cob_id: co.NO_REMOTE | self._can_id})
        except DriveRefusedError:
            return False
        finally:
            node.send_nmt(NMT_START)
        return True

    def _on_report(self, _can_id: int, data: bytearray, _timestamp: float) -> None:
        self._arrived.put((self._link.clock.now_s(), bytes(data)))

    def read(self, since_s: float | None) -> tuple[int, int, float | None, dict[str, InputValue]]:
        """Return statusword, position [counts], motor current [mA] and inputs; by SDO what is not reported in time.

        The motor current is None unless the report of a SYNC is awaited, which was sent then or later: who looks in
        between asks for it if the axis lags.
        """
        values = {} if since_s is None or not self.layout else self._take(since_s)
        current = None if since_s is None else self._current
        own = () if current is None else current[:1]
        for place in (*_REPORTED, *own, *(place for place, _ in self._inputs.values())):
            if place not in values:
                values[place] = self._node.upload(place)
        current_ma = None if current is None else values[current[0]] * current[1]
        inputs = {name: convert(values[place]) for name, (place, convert) in self._inputs.items()}
        return values[co.STATUSWORD], values[co.POSITION_ACTUAL], current_ma, inputs

    def _take(self, since_s: float) -> dict[Place, int]:
        """Return what was sent at the SYNC; nothing if that does not arrive in good time."""
        deadline_s = self._link.clock.now_s() + _REPORT_PATIENCE * self._link.answer_timeout_s
        while (report := self._link.receive(self._arrived, deadline_s)) is not None and report[0] < since_s:
            self.strays += 1
        if report is None or len(report[1]) != self._form.size:
            self.missed += 1
            return {}
        return dict(zip(self.layout, self._form.unpack(report[1]), strict=True))

    # Load

    def lag(self) -> float | None:
        """Return the following error, with its sign [mm or rad]; None if the drive does not tell it."""
        node, place = self._node, self._node.model.following_error
        return node.upload(place) / node.scale.counts_per_unit if node.model.has(place) else None

    def current_ma(self) -> float | None:
        """Return the motor current, with its sign [mA]; None if the drive does not measure it."""
        return None if self._current is None else self._node.upload(self._current[0]) * self._current[1]

    def current_limit_ma(self) -> int | None:
        """Return the limit of the output current [mA]; None if the drive has none."""
        found = self.current_limit
        return None if found is None else math.floor(self._node.upload(found[0]) * found[1])

    @cached_property
    def _current(self) -> tuple[Place, float] | None:
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

    @cached_property
    def _inputs(self) -> dict[str, _Input]:
        """The inputs that its section names. Raises `DriveError` if the drive lacks or hides one."""
        return {name: self._find_input(name, channel) for name, channel in self._node.section.inputs.items()}

    def _find_input(self, name: str, channel: InputChannel) -> _Input:
        model, source = self._node.model, channel.source
        bit = self._node.section.digital_inputs.get(source)
        if source in model.analog:
            return model.analog[source], lambda millivolts: channel.convert(millivolts / 1000)
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
        return model.inputs, lambda word: bool(word >> bit & 1)

    def read_inputs(self) -> dict[str, InputValue]:
        """Return what the inputs read that its section names."""
        return {name: convert(self._node.upload(place)) for name, (place, convert) in self._inputs.items()}
