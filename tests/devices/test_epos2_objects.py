"""The objects of the simulated EPOS2 against those of a real one: type, access, range, default and refusals.

`epos2_objects.csv` has index, subindex, type, access, range and default of the EPOS2 70/10 with software 0x2122, as
maxon's EDS file of March 2011 states them (in public: Pejman712/CRF, MaxonEPOS2.eds); empty where it states nothing.
"""

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import canopen
import pytest
from canopen.sdo.exceptions import SdoAbortedError

from labrig.devices import canopen_objects as co
from labrig.devices.canopen_objects import Entry
from labrig.devices.clocks import SimulatedClock
from labrig.devices.epos2 import objects as od
from labrig.devices.epos2.simulated_drive import SimulatedDrive
from labrig.devices.simulated.bus import InProcessWire, attach
from tests.devices.rigs import ANSWER_TIMEOUT_S

NODE, EPOS2_70_10 = 5, 0x6420
CODES = {"U8": "B", "U16": "H", "U32": "I", "I8": "b", "I16": "h", "I32": "i"}
READ_ONLY, TOO_LONG, TOO_SHORT, TOO_HIGH, TOO_LOW = 0x06010002, 0x06070012, 0x06070013, 0x06090031, 0x06090032

NARROWED = frozenset(
    {
        co.ERROR_COUNT,
        od.NODE_ID,
        *od.INPUTS,
        od.SENSOR_POLARITY,
        co.MODE,
        co.PROFILE_VELOCITY,
        co.PROFILE_TYPE,
    }
    | {co.PROFILE_ACCELERATION, co.PROFILE_DECELERATION, co.QUICK_STOP_DECELERATION, co.HOMING_ACCELERATION}
    | {co.HOMING_METHOD, co.HOMING_SPEED_SWITCH, co.HOMING_SPEED_INDEX, co.MAX_ACCELERATION}
    | {od.POSITION_NOTATION, od.POLE_PAIRS, od.MAX_MOTOR_SPEED}
)
"""Objects whose range is that of the firmware specification of the first generation: the EDS file states none."""


@dataclass(frozen=True)
class Row:
    """One object of the table."""

    type: str
    access: str
    low: int | None
    high: int | None
    default: int | None


def _number(text: str) -> int | None:
    """Return a number of the table, with the node id where it is added; None for an empty place."""
    number, _, with_node = text.partition("+")
    return int(number, 0) + NODE * bool(with_node) if text else None


def _read_table() -> dict[tuple[int, int], Row]:
    with Path(__file__).with_name("epos2_objects.csv").open(encoding="utf-8", newline="") as file:
        return {
            (int(row["index"], 16), int(row["subindex"])): Row(
                row["type"],
                "ro" if row["access"] == "const" else row["access"],
                *(_number(row[key]) for key in ("low", "high", "default")),
            )
            for row in csv.DictReader(file)
        }


TABLE = _read_table()


@dataclass
class Client:
    """A drive and an outside client of it."""

    drive: SimulatedDrive
    node: canopen.RemoteNode

    def served(self) -> list[Entry]:
        """Return every numeric object that the drive has."""
        found = (self.drive.objects.find(entry.index, entry.subindex) for entry in od.NUMBERS)
        return [entry for entry in found if entry is not None]

    def refusal(self, entry: Entry, data: bytes) -> int | None:
        """Write bytes to an object and return the abort code."""
        try:
            self.node.sdo.download(entry.index, entry.subindex, data)
        except SdoAbortedError as refusal:
            return int(refusal.code)
        return None


@pytest.fixture(name="client")
def _client() -> Iterator[Client]:
    wire, clock = InProcessWire(), SimulatedClock()
    drive = SimulatedDrive(wire, NODE, clock, hardware_version=EPOS2_70_10)
    link = attach(wire, clock, ANSWER_TIMEOUT_S)
    node = canopen.RemoteNode(NODE, canopen.ObjectDictionary())
    link.network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = 0.0
    yield Client(drive, node)
    link.close()
    drive.unplug()


def test_every_object_has_the_type_and_access_of_a_real_drive(client: Client) -> None:
    """No object is served that a real drive does not have, and none with another width, sign or access."""
    served = {(entry.index, entry.subindex): (entry.code, entry.access) for entry in client.served()}
    assert len(served) == len(od.NUMBERS)
    assert served == {place: (CODES[TABLE[place].type], TABLE[place].access) for place in served}


def test_every_range_is_that_of_a_real_drive(client: Client) -> None:
    """Where the EDS file states a limit, the drive has it; another one is named above."""
    for entry in client.served():
        row = TABLE[entry.index, entry.subindex]
        stated = Entry(entry.index, entry.subindex, "", CODES[row.type], lowest=row.low, highest=row.high)
        if (row.low, row.high) == (None, None) and entry in NARROWED:
            assert entry.bounds != stated.bounds
        else:
            assert entry.bounds == stated.bounds, entry


def test_every_default_is_that_of_a_real_drive(client: Client) -> None:
    """After power on each object has the default that the EDS file states, among them how many subindices there are."""
    indices = {entry.index for entry in client.served()}
    for (index, subindex), row in TABLE.items():
        if row.default is not None and index in indices:
            data = client.node.sdo.upload(index, subindex)
            assert Entry(index, subindex, "", CODES[row.type]).unpack(data) == row.default, hex(index)
            assert len(data) == Entry(index, subindex, "", CODES[row.type]).size


def test_another_length_is_refused_as_too_long_or_too_short(client: Client) -> None:
    """A write of another width than the object's is refused by the code of CiA 301 that says which."""
    for entry in client.served():
        if entry.access == "rw":
            if entry.size < 4:
                assert client.refusal(entry, bytes(entry.size + 1)) == TOO_LONG
            if entry.size > 1:
                assert client.refusal(entry, bytes(entry.size - 1)) == TOO_SHORT


def test_what_can_only_be_read_refuses_a_write(client: Client) -> None:
    """Read-only objects and the numbers of subindices are refused by the code for it, whatever is written."""
    count = Entry(co.VENDOR_ID.index, 0, "number of entries", "B")
    for entry in (count, *client.served()):
        if entry is count or entry.access == "ro":
            assert client.refusal(entry, bytes(entry.size)) == READ_ONLY


def test_values_beyond_the_range_are_refused(client: Client) -> None:
    """One below the lowest and one above the highest are refused by the code that says which."""
    tried = 0
    for entry in client.served():
        row = TABLE[entry.index, entry.subindex]
        for limit, beyond, code in ((row.low, -1, TOO_LOW), (row.high, 1, TOO_HIGH)):
            if limit and entry.access == "rw":
                assert client.refusal(entry, entry.pack(limit + beyond)) == code
                tried += 1
    assert tried == 16
