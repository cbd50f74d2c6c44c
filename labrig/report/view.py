"""What an experiment adds to the rerun view of a run."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from labrig.record.events import FrameLine
from labrig.record.following import RecordLines

Send = Callable[[Any, str], None]
"""(recording stream of rerun, name of its time line)"""

Follow = Callable[[Any, str, RecordLines], None]
"""(recording stream of rerun, name of its time line, lines of the record that it has not seen yet)"""


def _add_nothing(*_told: Any) -> None:
    """Add nothing."""


def _is_never_needed(_line: FrameLine) -> bool:
    """Let any picture be left out."""
    return False


@dataclass(frozen=True)
class View:
    """What is drawn beside the record.

    Attributes
    ----------
    curves, overviews : tuple of (str, str)
        Plots of the last minute and of the whole run: each its path and its heading with the unit, most important
        first.
    send : callable
        Sends at once all that a result adds.
    follow : callable
        Draws what lines of the record add, as they come; a view of a result has none.
    needs : callable
        Whether a picture is drawn however many wait, such as one from which a result is measured.
    words : Mapping
        The sentence of each kind of event that the experiment has, as a template over the fields of the event.
    added : tuple of str
        The place of each curve that `send` and `follow` draw, except those that they give a colour themselves.
    """

    curves: tuple[tuple[str, str], ...] = ()
    send: Send = _add_nothing
    follow: Follow = _add_nothing
    overviews: tuple[tuple[str, str], ...] = ()
    needs: Callable[[FrameLine], bool] = _is_never_needed
    words: Mapping[str, str] = field(default_factory=dict)
    added: tuple[str, ...] = ()


NO_VIEW = View()
"""Only the record."""


def show_record_alone(_run: object, _result: object) -> View:
    """Add nothing to the view of a record."""
    return NO_VIEW


def follow_record_alone(_run: object) -> View:
    """Add nothing to the view of a run that is being made, or was not measured."""
    return NO_VIEW
