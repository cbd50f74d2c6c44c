"""The sheath's pose before the needle leaves it, as a line of a run."""

from collections.abc import Mapping
from typing import Self

from labrig.analysis.result import TrialOrigin
from labrig.record.events import Event


class SheathEvent(Event):
    """The sheath was searched for; the line holds the fields of `origin`."""

    origin: TrialOrigin

    def line_fields(self) -> dict[str, object]:
        """Return the fields of the origin."""
        return self.origin.model_dump()

    @classmethod
    def read(cls, line: Mapping[str, object]) -> Self:
        """Return the event of a line. Raises pydantic's `ValidationError`."""
        known = {name: line[name] for name in TrialOrigin.model_fields if name in line}
        return cls.model_validate(
            {"t_s": line["t_s"], "origin": TrialOrigin.model_validate(known, strict=False)}
        )
