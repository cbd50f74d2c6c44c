"""Trials that count as done, from the lines of events."""

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from labrig.record.decisions import fold_decisions
from labrig.record.events import Event, MarkBad, OperatorNote, Repeat, Skip, TrialStop, Undo
from labrig.record.trial_count import count_trials_done

_TRIALS = st.integers(0, 3)
_EVENTS = st.one_of(
    st.builds(TrialStop, trial=_TRIALS, exit_status=st.sampled_from(["success", "aborted"])),
    st.builds(Repeat, trial=_TRIALS),
    st.builds(Skip, trial=_TRIALS),
    st.builds(MarkBad, trial=_TRIALS, reason=st.just("it slipped")),
    st.builds(OperatorNote, text=st.just("warm"), trial=_TRIALS),
    st.builds(Undo, undone=st.sampled_from(["repeat", "mark_bad", "skip", "note"])),
)


@given(st.lists(_EVENTS, max_size=12))
def test_lines_count_as_their_events_decide(events: list[Event]) -> None:
    """What a list of runs counts without models is what the evaluation leaves in."""
    decisions = fold_decisions(events)
    lines: list[dict[str, Any]] = [{"kind": event.kind, **event.model_dump(mode="json")} for event in events]
    assert count_trials_done(lines) == sum(
        isinstance(event, TrialStop)
        and event.exit_status == "success"
        and not decisions.explain_left_out(event.trial)
        for event in events
    )
