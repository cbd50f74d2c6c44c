"""The CAN bus of a record: compares what is sent, and delivers what was received."""

from collections.abc import Sequence
from dataclasses import dataclass
from queue import Empty, SimpleQueue

import can

from labrig.devices.bus import BusNetwork, CanLink
from labrig.devices.canopen_objects import CONTROLWORD
from labrig.devices.cia402_states import HALT
from labrig.devices.commands import CommandFormatter
from labrig.devices.replayed.clock import ReplayedClock
from labrig.devices.replayed.comparison import Comparison
from labrig.devices.simulated.bus import InProcessBus, InProcessWire
from labrig.record.can_log import CanFrame

_SYNC, _UPLOAD = 0x080, 0x40
_CONTROLWORD = CONTROLWORD.index.to_bytes(2, "little") + b"\0"


@dataclass(frozen=True)
class _Entry:
    """A CAN frame of the record, in microseconds of its session."""

    t_us: int
    can_id: int
    data: bytes
    sent: bool

    @property
    def is_read(self) -> bool:
        """Whether it only asks drives for values: an upload, or the SYNC at which they report."""
        return self.can_id == _SYNC or (0x600 < self.can_id < 0x680 and self.data[:1] == bytes([_UPLOAD]))

    @property
    def is_answer(self) -> bool:
        """Whether it answers a question."""
        return 0x580 < self.can_id < 0x600


class RecordedBus:
    """Follows a record frame by frame.

    Parameters
    ----------
    frames : sequence of CanFrame
        What passed, in order, in rig time of the session.
    clock : ReplayedClock
        Advanced with the record.
    heartbeat_id : int
        COB-ID of the computer's own heartbeat, which is no command.
    comparison : Comparison
        Counts commands that agree, and ends the replay at the first that does not.
    format_command : CommandFormatter
        Describes a command in words.
    passes_reads : bool
        Whether a sleep passes the reads that the record has meanwhile: those of a rig that watched its axes.
    """

    def __init__(
        self,
        frames: Sequence[CanFrame],
        clock: ReplayedClock,
        *,
        heartbeat_id: int,
        comparison: Comparison,
        format_command: CommandFormatter,
        passes_reads: bool = False,
    ) -> None:
        self.network = BusNetwork(clock)
        self._clock = clock
        self._comparison = comparison
        self._format_command = format_command
        self._heartbeat_id = heartbeat_id
        self._entries = [
            _Entry(round(frame.t_s * 1e6), frame.can_id, frame.data, frame.way == "T")
            for frame in frames
            if frame.way == "R" or frame.can_id != heartbeat_id
        ]
        self._next = 0
        self._answers: dict[tuple[int, bytes], bytes] = {}
        self._reports: dict[int, bytes] = {}
        clock.on_sleep(self._pass_until if passes_reads else self._deliver_until)

    # What the driver sends

    def send(self, can_id: int, data: bytes) -> None:
        """Compare a frame with the record, and deliver what answered it then.

        Raises
        ------
        ReplayDiffersError
            When the record has another command here.
        RecordEndsError
            When a record that was cut short has nothing more.
        """
        self._comparison.require_ongoing()
        if can_id == self._heartbeat_id:
            return
        now = _Entry(self._clock.now_us, can_id, data, sent=True)
        place = self._find_place(now)
        if place is None:
            self._answer_again(now)
            return
        self._consume(place)
        if not now.is_read:
            self._comparison.count_same("commands")
        self._deliver_until(self._clock.now_us)

    def _find_place(self, now: _Entry) -> int | None:
        """Return where the record has this frame; None for a read that it does not have before its next command."""
        for place in range(self._next, len(self._entries)):
            entry = self._entries[place]
            if entry.sent and (entry.can_id, entry.data) == (now.can_id, now.data):
                return place
            if entry.sent and not entry.is_read:
                if not now.is_read:
                    self._comparison.raise_difference("command", self._describe(entry), self._describe(now))
                return None
        return self._comparison.raise_end("command", self._describe(now))

    def _consume(self, place: int) -> None:
        """Continue after a sent frame. Deliver what arrived before it, except answers to skipped reads."""
        skips = any(entry.sent for entry in self._entries[self._next : place])
        for entry in self._entries[self._next : place]:
            if not entry.sent and not (skips and entry.is_answer):
                self._deliver(entry)
        self._clock.reach(self._entries[place].t_us)
        self._next = place + 1

    def _answer_again(self, read: _Entry) -> None:
        """Answer a read that the record does not have with the last answer of the drives."""
        if read.can_id == _SYNC:
            answers = dict(self._reports)
        else:
            answer_id = read.can_id - 0x600 + 0x580
            last = self._answers.get((answer_id, read.data[1:4]))
            answers = {} if last is None else {answer_id: last}
        if not answers:
            self._comparison.raise_difference("command", "no such read so far", self._describe(read))
        for can_id, data in answers.items():
            self.network.notify(can_id, bytearray(data), 0.0)

    # What arrives

    def deliver_next(self, until_us: int) -> bool:
        """Deliver the next frame that arrived by then, before anything else was sent; tell whether there was one."""
        entry = self._entries[self._next] if self._next < len(self._entries) else None
        if entry is None or entry.sent or entry.t_us > until_us:
            return False
        self._next += 1
        self._deliver(entry)
        return True

    def _deliver_until(self, until_us: int) -> None:
        while self.deliver_next(until_us):
            pass

    def _pass_until(self, until_us: int) -> None:
        """Deliver what arrived by then, also behind reads that the record has before it."""
        self._deliver_until(until_us)
        while self._next < len(self._entries) and self._entries[self._next].is_read:
            if self._entries[self._next].t_us >= until_us:
                return
            self._next += 1
            self._deliver_until(until_us)

    def find_sync_us(self) -> int:
        """Return the time [us] of the SYNC that the record sends next; now if it sends something else."""
        upcoming = next((entry for entry in self._entries[self._next :] if entry.sent), None)
        if upcoming is None or upcoming.can_id != _SYNC:
            return self._clock.now_us
        return max(upcoming.t_us, self._clock.now_us)

    def _deliver(self, entry: _Entry) -> None:
        self._clock.reach(entry.t_us)
        if entry.is_answer:
            self._answers[entry.can_id, entry.data[1:4]] = entry.data
        elif 0x180 < entry.can_id < 0x580:
            self._reports[entry.can_id] = entry.data
        self.network.notify(entry.can_id, bytearray(entry.data), 0.0)

    # The position in the record

    def is_halt_next(self, within_us: int) -> bool:
        """Return whether the next frame that the record sends is a halt, as after a signal, at this time."""
        for entry in self._entries[self._next :]:
            if entry.sent:
                is_halt = entry.data[1:4] == _CONTROLWORD and bool(
                    int.from_bytes(entry.data[4:6], "little") & HALT
                )
                return not entry.is_read and is_halt and entry.t_us <= self._clock.now_us + within_us
        return False

    def find_next_command(self) -> str | None:
        """Return the next command of the record in words; None at its end."""
        for entry in self._entries[self._next :]:
            if entry.sent and not entry.is_read:
                return self._describe(entry)
        return None

    def _describe(self, entry: _Entry) -> str:
        return self._format_command(entry.can_id, entry.data)


@dataclass(frozen=True)
class ReplayedLink(CanLink):
    """A link to the bus of a record: while it awaits an answer, what the record has arrives."""

    bus: RecordedBus | None = None

    def find_sync_s(self) -> float:
        """Return the time of the record: the time that a picture takes to arrive is not replayed."""
        assert self.bus is not None
        return self.bus.find_sync_us() / 1e6

    def receive(self, answers: SimpleQueue[bytes], deadline_s: float) -> bytes | None:
        """Return the next of `answers`; None, and the deadline reached, where the record has none by then."""
        bus, clock = self.bus, self.clock
        assert bus is not None
        assert isinstance(clock, ReplayedClock)
        until_us = round(deadline_s * 1e6)
        while True:
            try:
                return answers.get_nowait()
            except Empty:
                if not bus.deliver_next(until_us):
                    clock.reach(until_us)
                    return None


class _RecordedWire(InProcessWire):
    """A wire with a record at its other end."""

    def __init__(self, bus: RecordedBus) -> None:
        super().__init__()
        self._bus = bus

    def carry(self, sender: InProcessBus, message: can.Message) -> None:  # noqa: ARG002 - there is one sender
        """Hand a frame over."""
        self._bus.send(message.arbitration_id, bytes(message.data))


def attach(bus: RecordedBus, clock: ReplayedClock, answer_timeout_s: float) -> ReplayedLink:
    """Return a link to the bus of a record."""
    bus.network.bus = InProcessBus(_RecordedWire(bus), lambda _message: None, is_adapter=True)
    return ReplayedLink(bus.network, clock, answer_timeout_s, in_process=True, bus=bus)
