"""What a CANopen drive sends at each SYNC: its objects packed into transmit PDOs, received and unpacked."""

import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from queue import SimpleQueue

from labrig.devices.bus import CanLink
from labrig.devices.canopen_objects import Entry

_PDO_BYTES = 8


@dataclass(frozen=True)
class InputPlace:
    """Where an input of a drive is read.

    Parameters
    ----------
    entry : Entry
        The object that holds it.
    bit : int or None
        Its bit there; None for an analog input.
    volts : float
        Voltage of one unit of an analog input [V].
    """

    entry: Entry
    bit: int | None = None
    volts: float = 1.0


def pack_into_pdos(entries: Iterable[Entry], pdos: Sequence[int]) -> dict[int, tuple[Entry, ...]]:
    """Return which PDO carries which objects: each goes into the first with room; those without room are left out."""
    layouts: dict[int, tuple[Entry, ...]] = {}
    for entry in entries:
        for pdo in pdos:
            carried = layouts.get(pdo, ())
            if sum(other.size for other in carried) + entry.size <= _PDO_BYTES:
                layouts[pdo] = (*carried, entry)
                break
    return layouts


def mapping_of(entry: Entry) -> int:
    """Return the value by which a PDO's mapping names an object."""
    return entry.index << 16 | entry.subindex << 8 | 8 * entry.size


class DriveReports:
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
    layouts : mapping of int to tuple of Entry
        PDO that is switched on -> what it carries.
    missed, strays : int
        How many expected PDOs did not arrive, and how many came unexpected.
    """

    def __init__(self, link: CanLink, node_id: int, pdos: Sequence[int]) -> None:
        self.layouts: Mapping[int, tuple[Entry, ...]] = {}
        self._forms: dict[int, struct.Struct] = {}
        self.missed = self.strays = 0
        self._link = link
        self._is_awaited = False
        self._arrived: dict[int, SimpleQueue[bytes]] = {pdo: SimpleQueue() for pdo in pdos}
        for pdo, arrived in self._arrived.items():
            link.network.subscribe(0x180 + 0x100 * pdo + node_id, partial(_keep, arrived))

    def listen(self, layouts: Mapping[int, tuple[Entry, ...]]) -> None:
        """Take note of what each PDO carries from now on; those that are not named are switched off."""
        self.layouts = layouts
        self._forms = {
            pdo: struct.Struct("<" + "".join(entry.code for entry in layout))
            for pdo, layout in layouts.items()
        }

    def expect(self) -> None:
        """Drop what has arrived: the next `take` returns what the drive sends at the coming SYNC."""
        self._is_awaited = bool(self.layouts)
        for arrived in self._arrived.values():
            while not arrived.empty():
                arrived.get_nowait()
                self.strays += 1

    def take(self, patience_s: float) -> dict[Entry, int]:
        """Return what was sent at the SYNC, without what has not arrived after `patience_s`; once after `expect`."""
        is_awaited, self._is_awaited = self._is_awaited, False
        if not is_awaited:
            return {}
        deadline_s, values = self._link.clock.now_s() + patience_s, dict[Entry, int]()
        for pdo, layout in self.layouts.items():
            form = self._forms[pdo]
            data = self._link.receive(self._arrived[pdo], deadline_s)
            if data is None or len(data) != form.size:
                self.missed += 1
            else:
                values |= zip(layout, form.unpack(data), strict=True)
        return values


def _keep(arrived: SimpleQueue[bytes], _can_id: int, data: bytearray, _timestamp: float) -> None:
    arrived.put(bytes(data))
