"""Requests to pause a run, as a session sees them: who asks, and what they are told.

A request comes from outside (Ctrl+C at the terminal, `labrig pause` in another one) and waits for the next safe point.
These are, without any code of the experiment: before each question, after its answer, and the end of each trial. An
experiment names further ones with `Session.reach_safe_point`.
"""

BEFORE_QUESTION, AFTER_ANSWER, AT_QUESTION, TRIAL_END = (
    "before_question",
    "after_answer",
    "question",
    "trial_end",
)
"""The safe points that every run has, as the record names them; `question` is a pause chosen instead of an answer."""


class PauseRequests:
    """Requests to pause a run, and to continue it; here nobody can ask."""

    def find(self, point: str) -> str | None:  # noqa: ARG002
        """Return by what a pause at this safe point is asked for, such as `Ctrl+C`; None if by nothing."""
        return None

    def announce(self, when: str) -> None:
        """Tell those who have asked for a pause since the last call when it will begin."""

    def begin(self) -> None:
        """Note that the axes hold: the requests so far are met."""

    def find_continuation(self) -> str | None:
        """Return by what the pause is to end, such as `labrig continue`; None if by nothing so far."""
        return None

    def end(self) -> None:
        """Note that the run continues."""
