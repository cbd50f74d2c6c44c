"""What a person did during a run, in the order in which it happened: pauses, skips, repeats, marks, notes, undos."""

from collections.abc import Iterator

from labrig.record.events import Event, MarkBad, OperatorNote, OperatorQuestion, Pause, Repeat, Skip, Undo
from labrig.record.reader import Run
from labrig.report.formatting import Rows

_UNDONE = {
    Skip.kind: "the skip",
    Repeat.kind: "the repetition",
    MarkBad.kind: "the mark",
    OperatorNote.kind: "the note",
    OperatorQuestion.kind: "the answer to the question before",
}


def list_decisions(run: Run) -> Rows:
    """Return the rig time and a sentence for each thing that a person did; nothing if nobody did any."""
    return tuple((f"at {event.t_s:.0f} s", sentence) for event, sentence in _tell(run))


def _tell(run: Run) -> Iterator[tuple[Event, str]]:
    lasted_s = {pause.start.t_s: pause.duration_s for pause in run.pauses}
    for event in run.read_events(Pause, Skip, Repeat, MarkBad, OperatorNote, Undo):
        match event:
            case Pause():
                yield event, f"Paused {_tell_place(event)} by {event.by}{_tell_length(lasted_s[event.t_s])}."
            case Skip():
                yield event, f"Trial {event.trial} was skipped."
            case Repeat():
                yield event, f"Trial {event.trial} was to be made again; it is left out of the evaluation."
            case MarkBad():
                yield (
                    event,
                    f"Trial {event.trial} was marked as bad and is left out of the evaluation: {event.reason}",
                )
            case OperatorNote():
                of_trial = "" if event.trial is None else f" on trial {event.trial}"
                yield event, f"Note{of_trial}: {event.text}"
            case Undo():
                yield event, f"Taken back: {_UNDONE.get(event.undone, event.undone)}."


def _tell_place(pause: Pause) -> str:
    return "between two trials" if pause.trial is None else f"during trial {pause.trial}"


def _tell_length(duration_s: float | None) -> str:
    return ", until the run ended" if duration_s is None else f", for {duration_s:.0f} s"
