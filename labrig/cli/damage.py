"""What commands do with a damaged record: report the damage beside their result, or refuse the record."""

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from labrig.cli.output import say
from labrig.errors import Problem, RecordError


class OpenedRun(Protocol):
    """The path and the damage of an opened run."""

    path: Path
    damage: tuple[Problem, ...]


def report_damage(damage: Sequence[Problem | str]) -> str | None:
    """Print each damaged place, and return all of them as a sentence for --json, or None."""
    places = [place if isinstance(place, str) else f"{place.where}: {place.message}" for place in damage]
    for place in places:
        say(f"error: the record is damaged: {place}")
    return f"the record is damaged: {'; '.join(places)}" if places else None


def require_undamaged(run: OpenedRun) -> None:
    """Refuse a damaged run. Raises `RecordError`, which names the first damaged place."""
    if run.damage:
        first = run.damage[0]
        raise RecordError(f"{run.path} is damaged: {first.where}: {first.message}", "see: labrig runs check")
