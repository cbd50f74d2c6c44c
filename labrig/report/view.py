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
    """Curves beside the axes, as the path of each and its heading, and what sends them with whatever else is drawn."""

    curves: tuple[tuple[str, str], ...] = ()
    send: Send = _send_nothing


NO_VIEW = View()
"""The record alone."""


def show_record_alone(_run: object, _result: object) -> View:
    """Add nothing to the view of a record."""
    return NO_VIEW
