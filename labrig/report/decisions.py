"""What a person did during a run, in the order in which it happened: pauses, skips, repeats, marks, notes, undos.

Between them stand the conditions of the protocol that were met.
"""

from labrig.record.events import (
    ConditionMet,
    Event,
    MarkBad,
    OperatorNote,
    OperatorQuestion,
    Pause,
    Repeat,
    Skip,
    Undo,
)
from labrig.record.reader import Run
from labrig.report.formatting import Rows

TOLD = (Pause, Skip, Repeat, MarkBad, OperatorNote, Undo, ConditionMet)
"""The events that are told."""

_UNDONE = {
    Skip.kind: "the skip",
    Repeat.kind: "the repetition",
    MarkBad.kind: "the mark",
    OperatorNote.kind: "the note",
    OperatorQuestion.kind: "the answer to the question before",
}


def list_decisions(run: Run) -> Rows:
    """Return the rig time and a sentence for each thing that a person did, and each condition that was met."""
    lasted_s = {pause.start.t_s: pause.duration_s for pause in run.pauses}
    events = run.read_events(*TOLD)
    return tuple(
        (
            f"at {event.t_s:.0f} s",
            describe_decision(event, _tell_length(lasted_s[event.t_s]) if isinstance(event, Pause) else ""),
        )
        for event in events
    )


def describe_decision(event: Event, length: str = "") -> str:
    """Return what a person did, or which condition was met, as a sentence; `length` tells how long a pause was."""
    match event:
        case Pause():
            return f"Paused {_tell_place(event)} by {event.by}{length}."
        case Skip() | Repeat():
            again = "was to be made again; it is left out of the evaluation"
            return f"Trial {event.trial + 1} {again if isinstance(event, Repeat) else 'was skipped'}."
        case MarkBad():
            return (
                f"Trial {event.trial + 1} was marked as bad and is left out of the evaluation: {event.reason}"
            )
        case OperatorNote():
            of_trial = "" if event.trial is None else f" on trial {event.trial + 1}"
            return f"Note{of_trial}: {event.text}"
        case Undo():
            return f"Taken back: {_UNDONE.get(event.undone, event.undone)}."
        case ConditionMet():
            does = "the run stops" if event.action == "stop" else "the run asks"
            return (
                f"Trial {event.trial + 1}: {event.name} is {event.value:.4g}, {does} when {event.condition}."
            )
    raise TypeError(f"{type(event).__name__} is no decision")


def _tell_place(pause: Pause) -> str:
    return "between two trials" if pause.trial is None else f"during trial {pause.trial + 1}"


def _tell_length(duration_s: float | None) -> str:
    return ", until the run ended" if duration_s is None else f", for {duration_s:.0f} s"
