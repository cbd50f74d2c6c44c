"""What commands do with a record that is damaged: tell it beside what could be done, or refuse it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from labrig.cli.output import say
from labrig.errors import Problem, RecordError


class Damaged(Protocol):
    """A run that has been opened, as far as its damage goes."""

    path: Path
    damage: tuple[Problem, ...]


def tell_damage(damage: Sequence[Problem | str]) -> str | None:
    """Say each damaged place, and return all of them in a sentence for --json; None where there is none."""
    places = [one if isinstance(one, str) else f"{one.where}: {one.message}" for one in damage]
    for place in places:
        say(f"error: the record is damaged: {place}")
    return f"the record is damaged: {'; '.join(places)}" if places else None


def require_undamaged(run: Damaged) -> None:
    """Refuse a damaged run. Raises `RecordError`, which names the first place."""
    if run.damage:
        first = run.damage[0]
        raise RecordError(f"{run.path} is damaged: {first.where}: {first.message}", "see: labrig runs check")
