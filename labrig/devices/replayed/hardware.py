"""What takes the place of the hardware when a record is replayed."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from labrig.devices.bus import CanLink
from labrig.devices.camera import Exposure, PictureSource
from labrig.devices.camera_settings import Setting
from labrig.devices.commands import CommandFormatter
from labrig.devices.operator import NO_OFFER, Answer, Offer, OperatorRequest, Paused, request_details
from labrig.devices.past_insertion import PastInsertion
from labrig.devices.replayed.bus import RecordedBus, attach
from labrig.devices.replayed.comparison import Comparison
from labrig.devices.replayed.recording import Recording
from labrig.devices.rig_file import RigDescription
from labrig.devices.worker import SAME_THREAD

_REAL_SLACK_US = 100_000
"""How much a replay may lag behind a record of real time, in which every wait was a little longer than asked."""


class ReplayedHardware:
    """Clock, bus, camera and operator of a recorded session.

    Parameters
    ----------
    rig : RigDescription
        The rig file of the record.
    recording : Recording
        The session.
    comparison : Comparison
        Counts what is the same, and ends the replay at the first difference.
    """

    def __init__(self, rig: RigDescription, recording: Recording, comparison: Comparison) -> None:
        self.clock = comparison.clock
        self.camera_worker = self.disk_worker = SAME_THREAD
        self.operator = ReplayedOperator(recording, comparison)
        self._comparison = comparison
        self.bus = RecordedBus(
            recording.can_frames,
            self.clock,
            heartbeat_id=0x700 + rig.can.heartbeat.computer_node_id,
            comparison=comparison,
            format_command=CommandFormatter(rig),
            passes_reads=recording.guards > 0 and not recording.exact,
        )
        self._answer_timeout_s = rig.can.answer_timeout_ms / 1000
        self._recording = recording
        self._truth = iter(recording.truth)

    def open_link(self) -> CanLink:
        """Return a link to the bus of the record."""
        return attach(self.bus, self.clock, self._answer_timeout_s)

    def open_source(self) -> PictureSource:
        """Return the camera of the record."""
        return ReplayedSource(self._recording, self._comparison)

    def truth(self) -> tuple[dict[str, object], ...]:
        """Return the next truth of the simulated world in the record; nothing for a bench."""
        truth = next(self._truth, None)
        return () if truth is None else (truth,)

    def recall(self, insertions: Sequence[PastInsertion]) -> None:
        """Do nothing: the pictures have been taken."""

    def close(self) -> None:
        """Nothing to release."""

    def find_signal(self) -> str | None:
        """Return the signal that ended the session once the record holds nothing more than stopping."""
        slack_us = 0 if self._recording.exact else _REAL_SLACK_US
        stops = self._recording.stopped_by is not None and self.bus.is_halt_next(slack_us)
        return self._recording.stopped_by if stops else None


class ReplayedSource:
    """The camera of a record: accepts the recorded settings and gives the recorded pictures in order."""

    def __init__(self, recording: Recording, comparison: Comparison) -> None:
        self.exposures = 0
        self._settings: Mapping[str, Setting] = recording.camera
        self._pictures = iter(recording.pictures)
        self._comparison = comparison

    def set(self, name: str, value: Setting) -> None:
        """Do nothing: what is asked is compared with what the recorded camera read back."""

    def get(self, name: str) -> Setting | None:
        """Return what the recorded camera read back."""
        return self._settings.get(name)

    def read(self) -> Exposure | None:
        """Return the next picture; its SHA-256 is verified."""
        self._comparison.require_ongoing()
        self.exposures += 1
        number, exposure = next(self._pictures, (None, None))
        if number is None:
            self._comparison.raise_end("frame", "one more picture")
        self._comparison.frame = number
        if exposure is None or exposure.t_s is None:
            return exposure
        # Real time is not replayed to the microsecond; a picture is never older than its command.
        return replace(exposure, t_s=max(exposure.t_s, self._comparison.clock.now_s()))

    def close(self) -> None:
        """Nothing to release."""


class ReplayedOperator:
    """The operator of a record: the question must be the recorded one, and gets the recorded answer."""

    def __init__(self, recording: Recording, comparison: Comparison) -> None:
        self._questions = iter(recording.questions)
        self._run = recording.run
        self._exact = recording.exact
        self._comparison = comparison

    def ask(
        self,
        request: OperatorRequest,
        meanwhile: Callable[[], None],
        offer: Offer = NO_OFFER,  # noqa: ARG002 - what was chosen is recorded
    ) -> Answer:
        """Compare a question, let the time pass that its answer took, and return the answer.

        A person who pauses a simulated rig lets no rig time pass, so that the rig is supervised once, however long that
        took; every other question of a simulated rig was answered at once.
        """
        self._comparison.require_ongoing()
        now = f"{type(request).__name__}: {request.text}"
        question = next(self._questions, None)
        if question is None:
            self._comparison.raise_end("question", now)
        if (question.request, _to_plain(question.details)) != (
            type(request).__name__,
            _to_plain(request_details(request, self._run)),
        ):
            self._comparison.raise_difference("question", f"{question.request} {dict(question.details)}", now)
        self._comparison.count_same("questions")
        if self._exact and isinstance(request, Paused):
            meanwhile()
        self._comparison.clock.pass_until(round(question.t_s * 1e6))
        return question.answer


def _to_plain(value: object) -> object:
    """Return a value as a record holds it: tuples become lists."""
    if isinstance(value, Mapping):
        return {str(key): _to_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_to_plain(item) for item in value]
    return value
