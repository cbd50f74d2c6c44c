"""The bus of a record: which commands count as the same."""

from datetime import UTC, datetime
from pathlib import Path
from queue import SimpleQueue

import pytest

from labrig.devices.commands import CommandFormatter
from labrig.devices.needle_state import RigState
from labrig.devices.replayed.bus import RecordedBus, ReplayedLink, attach
from labrig.devices.replayed.comparison import Comparison
from labrig.devices.replayed.recording import Recording, Span
from labrig.errors import RecordEndsError, ReplayDiffersError
from labrig.record.can_log import CanFrame
from tests.devices.rigs import simulated_rig

READ_STATUS, STATUS = bytes.fromhex("4041600000000000"), bytes.fromhex("4B41600037020000")
READ_POSITION, POSITION = bytes.fromhex("4064600000000000"), bytes.fromhex("4364600010270000")
TARGET, OTHER_TARGET = bytes.fromhex("237A600000E20400"), bytes.fromhex("237A600001E20400")
TAKEN = bytes.fromhex("607A600000000000")
BEAT, REPORT = b"\x05", bytes.fromhex("370200000000")

RECORD = (
    CanFrame(0.0, 0x77F, BEAT, "T"),
    CanFrame(0.1, 0x601, READ_STATUS, "T"),
    CanFrame(0.101, 0x581, STATUS, "R"),
    CanFrame(0.15, 0x701, BEAT, "R"),
    CanFrame(0.2, 0x601, READ_POSITION, "T"),
    CanFrame(0.201, 0x581, POSITION, "R"),
    CanFrame(0.25, 0x080, b"", "T"),
    CanFrame(0.25, 0x381, REPORT, "R"),
    CanFrame(0.3, 0x601, TARGET, "T"),
    CanFrame(0.302, 0x581, TAKEN, "R"),
    CanFrame(0.5, 0x701, BEAT, "R"),
)


class Bus:
    """A replayed bus with somebody who listens to node 1."""

    def __init__(self, *, to_the_end: bool = True) -> None:
        recording = Recording(
            run=Path("run"), started=datetime(2026, 3, 2, tzinfo=UTC), span=Span(0.0, 1e9), can_frames=RECORD,
            questions=(), truth=(), pictures=(), first_frame=0, camera={}, state=RigState(False),
            stopped_by=None, exact=True, to_the_end=to_the_end, is_first=True, trials=frozenset(), guards=0,
        )  # fmt: skip
        self.comparison = Comparison(recording)
        self.clock = self.comparison.clock
        self.bus = RecordedBus(
            RECORD,
            self.clock,
            heartbeat_id=0x77F,
            comparison=self.comparison,
            format_command=CommandFormatter(simulated_rig()),
        )
        self.link: ReplayedLink = attach(self.bus, self.clock, 0.2)
        self.answers: SimpleQueue[bytes] = SimpleQueue()
        self.beats: list[float] = []
        self.link.network.subscribe(0x581, lambda _id, data, _t: self.answers.put(bytes(data)))
        self.reports: list[bytes] = []
        self.link.network.subscribe(0x381, lambda _id, data, _t: self.reports.append(bytes(data)))
        self.link.network.subscribe(0x701, lambda _id, _data, _t: self.beats.append(self.clock.now_s()))

    def ask(self, data: bytes) -> bytes | None:
        """Send a question to node 1 and return the answer."""
        self.link.send(0x601, data)
        return self.link.receive(self.answers, self.clock.now_s() + 0.2)


def test_recorded_commands_get_recorded_answers_and_times() -> None:
    """Frames that a drive sent by itself arrive in between; time never goes back."""
    bus = Bus()
    assert (bus.ask(READ_STATUS), bus.clock.now_s()) == (STATUS, 0.101)
    bus.clock.sleep(0.099)
    assert (bus.beats, bus.clock.now_s()) == ([0.15], 0.2)
    assert (bus.ask(READ_POSITION), bus.ask(TARGET)) == (POSITION, TAKEN)
    bus.clock.sleep(1.0)
    assert bus.beats == [0.15, 0.5]
    assert bus.bus.find_next_command() is None
    assert bus.comparison.counts == {"commands": 1}


def test_the_number_of_reads_and_heartbeats_does_not_matter() -> None:
    """An extra read gets the last answer again, a missing one is skipped."""
    bus = Bus()
    assert bus.ask(READ_STATUS) == STATUS
    assert bus.ask(READ_STATUS) == STATUS
    for _ in range(3):
        bus.link.send(0x77F, BEAT)
    assert bus.ask(TARGET) == TAKEN
    assert bus.beats == [0.15]


def test_drives_report_at_each_sync_however_often_it_is_sent() -> None:
    """A recorded SYNC brings its report, an extra one the same again; SYNC is not a command."""
    bus = Bus()
    bus.link.send(0x080, b"")
    bus.link.send(0x080, b"")
    assert bus.reports == [REPORT, REPORT]
    assert bus.comparison.counts == {}


def test_another_command_is_a_difference() -> None:
    """Both targets are given in quadcounts and mm; nothing is answered after that."""
    bus = Bus()
    with pytest.raises(ReplayDiffersError, match="the record has insertion: target position"):
        bus.ask(OTHER_TARGET)
    found = bus.comparison.found
    assert found is not None
    assert found.recorded == "insertion: target position (0x607A:00) = 320000 quadcounts, 80.0000 mm"
    assert found.now == "insertion: target position (0x607A:00) = 320001 quadcounts, 80.0002 mm"
    with pytest.raises(ReplayDiffersError):
        bus.ask(READ_STATUS)


def test_a_missing_command_is_a_difference() -> None:
    """A recorded command that the replay did not send is named."""
    bus = Bus()
    bus.ask(READ_STATUS)
    assert (
        bus.bus.find_next_command()
        == "insertion: target position (0x607A:00) = 320000 quadcounts, 80.0000 mm"
    )


@pytest.mark.parametrize(("to_the_end", "error"), [(True, ReplayDiffersError), (False, RecordEndsError)])
def test_a_command_after_the_end_differs_unless_the_run_was_interrupted(
    to_the_end: bool, error: type[Exception]
) -> None:
    """A finished run sent no more; that of an interrupted one is unknown."""
    bus = Bus(to_the_end=to_the_end)
    bus.ask(TARGET)
    with pytest.raises(error):
        bus.ask(TARGET)


def test_an_unrecorded_read_is_a_difference() -> None:
    """The record has no answer to it."""
    with pytest.raises(ReplayDiffersError, match="position"):
        Bus().ask(bytes.fromhex("4062600000000000"))


def test_an_unanswered_request_stays_unanswered() -> None:
    """It runs into its timeout, as in the record."""
    bus = Bus()
    bus.ask(TARGET)
    assert bus.link.receive(bus.answers, bus.clock.now_s() + 0.1) is None
    assert bus.clock.now_s() == pytest.approx(0.402)
