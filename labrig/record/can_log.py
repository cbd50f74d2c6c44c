"""Read can.log, whose lines have candump's format and no checksum, and verify it with can.sums.jsonl."""

import re
import zlib
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from labrig.errors import Problem, RecordError
from labrig.input_file import MAX_LOG_BYTES, read_file
from labrig.record.json_lines import read_lines
from labrig.record.layout import CAN_LOG, CAN_SUMS, COPY_HINT, inside

_LINE = re.compile(rb"\((\d+\.\d{6})\) can ([0-9A-F]{3})#((?:[0-9A-F]{2}){0,8}) ([TR])")
# Possessive: a log of any length is matched without memory for a way back.
_LINES = re.compile(rb"(?:" + _LINE.pattern + rb"\n)*+")


class CanFrame(NamedTuple):
    """A CAN frame of the record: rig time [s], COB-ID, data, and T or R for sent or received."""

    t_s: float
    can_id: int
    data: bytes
    way: str


@dataclass(frozen=True)
class CanLog:
    """The part of can.log that its sums cover.

    Attributes
    ----------
    content : bytes
        The covered part.
    damaged : tuple of Problem
        Parts that are missing or whose CRC-32 does not fit.
    torn : tuple of Problem
        The end that no sum covers, as a killed process leaves it.
    """

    content: bytes
    damaged: tuple[Problem, ...]
    torn: tuple[Problem, ...]

    def require_frames(self) -> None:
        """Require that every line is a CAN frame. Raises `RecordError` as `frames`."""
        if self.damaged or not _LINES.fullmatch(self.content):
            deque(self.frames(), maxlen=0)

    def frames(self) -> Iterator[CanFrame]:
        """Yield the frames in order. Raises `RecordError` for a damaged part or a line that is no CAN frame."""
        if self.damaged:
            raise RecordError(f"{self.damaged[0].where}: {self.damaged[0].message}", self.damaged[0].hint)
        for number, line in enumerate(self.content.splitlines(), start=1):
            found = _LINE.fullmatch(line)
            if found is None:
                raise RecordError(f"{CAN_LOG}:{number}: the line is no CAN frame", COPY_HINT)
            t_s, can_id, data, way = found.groups()
            yield CanFrame(float(t_s), int(can_id, 16), bytes.fromhex(data.decode()), way.decode())


def read_can_log(run: Path) -> CanLog:
    """Read can.log of a run; empty for a run without a bus. A log without sums, of an early labrig, is taken whole.

    Raises
    ------
    RecordError
        When a file cannot be read, or a line of the sums is damaged.
    """
    log, sums_file = inside(run, CAN_LOG), inside(run, CAN_SUMS)
    if not sums_file.exists():
        return CanLog(_read(log) if log.exists() else b"", (), ())
    content, sums = _read(log), read_lines(sums_file)
    damaged, start = [], 0
    for number, line in enumerate(sums, start=1):
        end, crc32 = line.get("bytes"), line.get("part_crc32")
        if not isinstance(end, int) or not start <= end:
            raise RecordError(f"{sums_file}:{number}: bytes is {end!r}, expected {start} or more", COPY_HINT)
        if f"{zlib.crc32(content[start:end]):08x}" != crc32 or end > len(content):
            place = f"{CAN_LOG}, bytes {start} to {end}"
            damaged.append(Problem(place, "its CRC-32 does not fit its content", COPY_HINT))
        start = end
    return CanLog(content[:start], tuple(damaged), _find_torn_end(content, start))


def _find_torn_end(content: bytes, covered: int) -> tuple[Problem, ...]:
    if len(content) <= covered:
        return ()
    message = f"the last {len(content) - covered} bytes have no checksum yet and are left out"
    return (Problem(CAN_LOG, message, "the writer was stopped while it wrote them; all before is whole"),)


def _read(path: Path) -> bytes:
    try:
        return read_file(path, MAX_LOG_BYTES)
    except OSError as error:
        raise RecordError(f"cannot read {path}: {error.strerror}", COPY_HINT) from error
