"""Read the lines of a record while another process writes it, or all of them at once.

A line is in the kernel before the writer goes on, and a picture is complete under its name before its line is written.
So whoever follows a run reads files and asks nothing of the process that makes it: it can neither delay nor stop that.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from labrig.clock import Clock
from labrig.errors import RecordError
from labrig.input_file import open_file
from labrig.record.json_lines import decode_line
from labrig.record.layout import ALWAYS_PRESENT, COPY_HINT, EVENT_LINES, FRAME_LINES, STATE_LINES, run_lock
from labrig.record.lock import read_lock_owner
from labrig.record.pictures import RecordedPicture, locate_pictures
from labrig.record.reader import Run

_MOST_BYTES = 2**22
"""Of a file that are read at once."""
_LOOK_EVERY_S = 0.05


@dataclass(frozen=True)
class RecordLines:
    """Consecutive lines of a record, each sequence in order: events and states as documents, and pictures."""

    events: Sequence[Mapping[str, object]] = ()
    states: Sequence[Mapping[str, object]] = ()
    pictures: Sequence[RecordedPicture] = ()

    def __bool__(self) -> bool:
        """Return whether there are any."""
        return bool(self.events or self.states or self.pictures)


def list_lines(run: Run) -> RecordLines:
    """Return all lines of a run. Raises `RecordError` when one is damaged."""
    return RecordLines(run.lines("events"), run.lines("states"), run.pictures.places)


class GrowingRun:
    """The record of a run that is being made, read from its beginning.

    Parameters
    ----------
    path : Path
        Its folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._read_bytes = dict.fromkeys(ALWAYS_PRESENT, 0)
        self._frames = 0

    def has_ended(self) -> bool:
        """Return whether no process writes the run any more, however it ended."""
        return read_lock_owner(run_lock(self.path)) is None

    def read_new(self) -> RecordLines:
        """Return the lines that were added since the last call; of very many only the first ones.

        Raises
        ------
        RecordError
            When a file cannot be read, or a line is damaged.
        """
        pictures = locate_pictures(self.path, self._read_lines(FRAME_LINES), self._frames)
        self._frames += len(pictures)
        return RecordLines(self._read_lines(EVENT_LINES), self._read_lines(STATE_LINES), pictures)

    def follow(self, clock: Clock) -> Iterator[RecordLines]:
        """Yield what `read_new` gives at each look, also nothing, until all is read and no process writes any more.

        Raises
        ------
        RecordError
            As `read_new`.
        """
        while True:
            # Asked first, so that nothing is missed that was written just before the end.
            ended = self.has_ended()
            lines = self.read_new()
            yield lines
            if not lines:
                if ended:
                    return
                clock.sleep(_LOOK_EVERY_S)

    def _read_lines(self, name: str) -> list[dict[str, object]]:
        path = self.path / name
        try:
            with open_file(path) as file:
                file.seek(self._read_bytes[name])
                content = file.read(_MOST_BYTES)
            *whole, torn = content.split(b"\n")
            lines = [decode_line(line) for line in whole]
        except (OSError, ValueError) as error:
            raise RecordError(f"cannot read {path}: {error}", COPY_HINT) from error
        self._read_bytes[name] += len(content) - len(torn)
        return lines
