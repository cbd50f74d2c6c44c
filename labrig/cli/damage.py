"""What commands do with a damaged record: report the damage beside their result, or refuse the record."""

from collections.abc import Sequence
from pathlib import Path

from labrig.cli.output import say
from labrig.errors import Problem, RecordError


def report_damage(damage: Sequence[Problem | str]) -> str | None:
    """Print each damaged place, and return all of them as a sentence for --json, or None."""
    places = [place if isinstance(place, str) else f"{place.where}: {place.message}" for place in damage]
    for place in places:
        say(f"error: the record is damaged: {place}")
    return f"the record is damaged: {'; '.join(places)}" if places else None


def require_undamaged(
    run: Path | str, damage: Sequence[Problem], hint: str = "see: labrig runs check"
) -> None:
    """Refuse a damaged run. Raises `RecordError`, which names the first damaged place."""
    if damage:
        raise RecordError(f"{run} is damaged: {damage[0].where}: {damage[0].message}", hint)
