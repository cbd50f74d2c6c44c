"""The events that `labrig import` records."""

from typing import ClassVar

from labrig.record.events import Event


class PictureRefused(Event):
    """A file that is no picture was left out."""

    kind: ClassVar[str] = "picture_refused"

    source: str
    reason: str
