"""What an experiment adds to the rerun view of a run."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Send = Callable[[Any, str], None]
"""(recording stream of rerun, name of its time line)"""


def _send_nothing(_stream: Any, _timeline: str) -> None:
    """Add nothing."""


@dataclass(frozen=True)
class View:
    """Curves beside the axes, each with its path and heading, and the call that sends them and all other drawings."""

    curves: tuple[tuple[str, str], ...] = ()
    send: Send = _send_nothing


NO_VIEW = View()
"""Only the record."""


def show_record_alone(_run: object, _result: object) -> View:
    """Add nothing to the view of a record."""
    return NO_VIEW
