"""Replays a record: runs the same procedure on recorded devices, and compares its commands and lines."""

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labrig.devices.replayed.comparison import Comparison, DifferingLines, ReplayDifference
from labrig.devices.replayed.hardware import ReplayedHardware
from labrig.devices.replayed.opening import load_recorded_rig, open_replayed
from labrig.devices.replayed.recording import Recording, make_recording_without_rig, read_recordings
from labrig.devices.rig import Opening
from labrig.devices.rig_file import RigDescription
from labrig.errors import InputError, RecordEndsError, ReplayDiffersError
from labrig.protocol.sections import ExperimentProtocol
from labrig.protocol.yaml_tree import load_yaml_values
from labrig.record.events import Event, Pause, RunStop, TrialStart
from labrig.record.json_lines import as_recorded
from labrig.record.reader import Run
from labrig.runner.conduct import conduct, conduct_remainder, conduct_without_rig
from labrig.runner.dialogue import Dialogue
from labrig.runner.experiment import Experiment
from labrig.runner.known_changes import KnownChange, find_known_change
from labrig.runner.pausing import NoRequests
from labrig.runner.session import Progress, Session

_STREAMS = {"events": "event", "states": "state", "frames": "frame", "truth": "truth"}


@dataclass
class Replay:
    """The result of a replay.

    Attributes
    ----------
    first_difference : ReplayDifference or None
        None if everything was identical as far as the record goes.
    known_change : KnownChange or None
        The change of labrig that explains this difference; None if none is known to.
    ended_early : str
        Where an incomplete record ends; empty for a complete one.
    bit_exact : bool
        Whether every line and every CAN frame was reproduced to the last bit, times included.
    counts : dict
        The numbers of compared commands, questions, pictures and lines.
    """

    first_difference: ReplayDifference | None = None
    known_change: KnownChange | None = None
    ended_early: str = ""
    bit_exact: bool = True
    counts: dict[str, int] = field(default_factory=dict)

    @property
    def identical(self) -> bool:
        """Whether nothing differs."""
        return self.first_difference is None


def replay_run(run: Run, experiment: Experiment, protocol: ExperimentProtocol, progress: Progress) -> Replay:
    """Run the procedure of a record with its recorded camera, drives, clock and operator, session by session.

    Raises
    ------
    InputError
        For a run that was not made by a procedure.
    RecordError
        When the record is damaged.
    """
    if not experiment.moves_rig and experiment.plan(protocol, None).problems:
        raise InputError(
            f"{run.path} holds imported pictures; no procedure made it", "there is nothing to replay"
        )
    if run.withdraws is not None:
        raise InputError(
            f"{run.path} is the withdrawal of the needle of run {run.withdraws}; it goes as a person answers",
            "there is nothing to replay; its states, events and can.log show what was done",
        )
    found = Replay()
    if not experiment.moves_rig:
        _replay_without_rig(run, experiment, found)
        return found
    description = load_recorded_rig(run)
    for recording in read_recordings(run, exact=description.kind == "simulated"):
        _replay_session(_Replayed(run, experiment, protocol, description), recording, progress, found)
        if not found.identical:
            break
    return found


def replay_work(run: Run, experiment: Experiment, protocol: ExperimentProtocol) -> float:
    """Return the end of the progress of a replay."""
    if not experiment.moves_rig:
        return 1.0
    return experiment.plan(protocol, load_recorded_rig(run)).work


@dataclass(frozen=True)
class _Replayed:
    """The run whose procedure runs again, and its rig."""

    run: Run
    experiment: Experiment
    protocol: ExperimentProtocol
    rig: RigDescription


def _replay_without_rig(run: Run, experiment: Experiment, found: Replay) -> None:
    """Replay a run that moved nothing: only its beginning and its end are compared."""
    recording = make_recording_without_rig(run)
    comparison = Comparison(recording)
    try:
        conduct_without_rig(experiment, ReplayedJournal(run, recording, comparison), comparison.clock)
    except ReplayDiffersError:
        _keep_difference(found, comparison, run)
    except RecordEndsError as error:
        found.ended_early = error.message
    found.bit_exact = found.identical
    found.counts = comparison.counts


def _replay_session(replayed: _Replayed, recording: Recording, progress: Progress, found: Replay) -> None:
    """Replay one session and add its result."""
    comparison, journal = Comparison(recording), None
    try:
        opening = Opening(max_current_ma=replayed.protocol.current_limits_ma)
        with open_replayed(replayed.rig, recording, comparison, opening) as (rig, hardware):
            rig.describe()  # reads the state of the devices, as when the record was begun
            journal = ReplayedJournal(replayed.run, recording, comparison)
            dialogue = Dialogue(requests=RecordedRequests(journal))
            _conduct(replayed, recording, Session(rig, journal, progress, dialogue))
            _require_nothing_left(hardware, journal, comparison)
    except ReplayDiffersError:
        _keep_difference(found, comparison, replayed.run)
    except RecordEndsError as error:
        found.ended_early = error.message
        left = None if journal is None else journal.find_next_line(besides=RunStop.kind)
        if left is not None:
            found.first_difference = comparison.make_difference(left[0], left[1], "nothing")
    exact = journal is not None and journal.can_frames_are_exact()
    found.bit_exact = found.bit_exact and found.identical and recording.exact and exact
    for what, count in comparison.counts.items():
        found.counts[what] = found.counts.get(what, 0) + count


def _keep_difference(found: Replay, comparison: Comparison, run: Run) -> None:
    """Keep the first difference, and the change of labrig that explains it."""
    found.first_difference = comparison.found
    rig = {} if run.rig_path is None else load_yaml_values(run.rig_path)
    found.known_change = find_known_change(comparison.lines, {"protocol": run.protocol, "rig": rig})


def _conduct(replayed: _Replayed, recording: Recording, session: Session) -> None:
    experiment, protocol = replayed.experiment, replayed.protocol
    if recording.is_first:
        conduct(experiment, protocol, session)
        return
    remainder = experiment.resume(protocol, replayed.run.until(recording.span.t0_s))
    conduct_remainder(experiment, remainder, session)


def _require_nothing_left(
    hardware: ReplayedHardware, journal: "ReplayedJournal", comparison: Comparison
) -> None:
    """Raise `ReplayDiffersError` if the record continues after the end of the procedure."""
    command, line = hardware.bus.find_next_command(), journal.find_next_line()
    if command is not None:
        comparison.raise_difference("command", command, "nothing")
    if line is not None:
        comparison.raise_difference(line[0], line[1], "nothing")


class ReplayedJournal:
    """Compares what a procedure records with the lines of the record."""

    def __init__(self, run: Run, recording: Recording, comparison: Comparison) -> None:
        self.run_name = run.path.name
        self.path: Path = run.path
        self._run = run
        self._comparison = comparison
        self._recording = recording
        self._t0_s = recording.span.t0_s
        self._frame = recording.first_frame
        self._can: list[tuple[float, int, bytes, str]] = []
        self._expected = {stream: deque(self._select_lines(run, stream)) for stream in _STREAMS}

    def _select_lines(self, run: Run, stream: str) -> Iterable[Mapping[str, Any]]:
        if stream == "truth":
            return [line for line in run.lines(stream) if line.get("trial") in self._recording.trials]
        return self._recording.span.of(run.lines(stream))

    def frame(self, image: NDArray[np.uint8], t_s: float, **fields: object) -> int:
        """Compare the line of a picture, and a drawn picture itself, and return its number."""
        number = self._frame
        line = {"frame": number, "t_s": self._t0_s + t_s, **fields}
        self._compare("frames", line, without=("file", "sha256", "offset", "bytes", "shape"))
        if fields.get("drawn") and not np.array_equal(image, self._run.read_frame(number)):
            self._comparison.raise_difference("frame", f"picture {number}", "another drawing")
        self._frame += 1
        return number

    def state(self, t_s: float, **fields: object) -> None:
        """Compare a state of the axes."""
        self._compare("states", {"t_s": self._t0_s + t_s, **fields})

    def event(self, kind: str, t_s: float, **fields: object) -> None:
        """Compare an event."""
        if kind == TrialStart.kind and isinstance(trial := fields.get("trial"), int):
            self._comparison.trial = trial
        self._compare("events", {"kind": kind, "t_s": self._t0_s + t_s, **fields})

    def record_event(self, event: Event, t_s: float) -> None:
        """Compare an event."""
        self.event(event.kind, t_s, **event.line_fields())

    def truth(self, **fields: object) -> None:
        """Compare a truth of the simulated world."""
        self._compare("truth", fields)

    def can_frames(self, frames: Iterable[tuple[float, int, bytes, str]]) -> None:
        """Keep the frames on the bus."""
        self._can += frames

    def close(self, exit_status: str, reason: str, ended: datetime, **updates: object) -> None:
        """Do nothing: the last event states how the run ended."""

    def can_frames_are_exact(self) -> bool:
        """Return whether the same CAN frames passed at the same times as in the record."""
        return _convert_to_microseconds(self._can) == _convert_to_microseconds(self._recording.can_frames)

    def peek_event(self) -> Mapping[str, Any]:
        """Return the next event of the record; an empty line at its end."""
        return self._expected["events"][0] if self._expected["events"] else {}

    def find_next_line(self, besides: str | None = None) -> tuple[str, str] | None:
        """Return the stream and the text of the next line of the record, an event of kind `besides` left out."""
        for stream, lines in self._expected.items():
            for line in lines:
                if line.get("kind") != besides or besides is None:
                    return _STREAMS[stream], str(dict(line))
        return None

    def _compare(self, stream: str, now: Mapping[str, object], without: tuple[str, ...] = ()) -> None:
        self._comparison.require_ongoing()
        what = _STREAMS[stream]
        plain = as_recorded(now)
        if not self._expected[stream]:
            self._comparison.raise_end(what, str(plain))
        recorded = self._expected[stream].popleft()
        left_out = {*without, *(() if self._recording.exact else ("t_s",))}
        for key in dict.fromkeys((*recorded, *plain)):
            if key not in left_out and recorded.get(key) != plain.get(key):
                compared = (_leave_out(line, left_out) for line in (recorded, plain))
                self._comparison.lines = DifferingLines(what, *compared)
                name = f"{recorded.get('kind', what)}: {key} = "
                self._comparison.raise_difference(
                    what, f"{name}{recorded.get(key)!r}", f"{name}{plain.get(key)!r}"
                )
        self._comparison.count_same(f"{what}s" if what != "truth" else what)


class RecordedRequests(NoRequests):
    """Asks for a pause at the safe points where the record has one.

    Parameters
    ----------
    journal : ReplayedJournal
        Knows the next event of the record.
    """

    def __init__(self, journal: ReplayedJournal) -> None:
        self._journal = journal

    def find(self, point: str) -> str | None:
        """Return by what the record was paused, if its next event is a pause at this point."""
        line = self._journal.peek_event()
        return str(line.get("by")) if line.get("kind") == Pause.kind and line.get("point") == point else None


def _leave_out(line: Mapping[str, Any], keys: set[str]) -> dict[str, Any]:
    return {key: value for key, value in line.items() if key not in keys}


def _convert_to_microseconds(
    frames: Iterable[tuple[float, int, bytes, str]],
) -> list[tuple[int, int, bytes, str]]:
    """Return CAN frames with times in microseconds, as in can.log."""
    return [(round(t_s * 1e6), can_id, data, way) for t_s, can_id, data, way in frames]
