"""Records cut at every byte of a file's last kilobyte, and with flipped bits: is anything wrong ever read?"""

import random
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from labrig.record import open_run
from tests.benchmarks.table import print_rows
from tests.record.faults import RAW_FILES, Values, full_run, is_noticed_or_unchanged, told, values

FLIPS = 1000
_LAST_BYTES = 1024


def print_table(flips: int = FLIPS) -> None:
    """Print how many cuts and flips of an open and of a closed run were noticed, or changed nothing that is read."""
    rows = []
    for closed in (False, True):
        with tempfile.TemporaryDirectory() as folder:
            run = full_run(Path(folder), closed=closed)
            original = values(open_run(run))
            for what, outcomes in (
                ("cut at a byte of its last kilobyte", list(_cuts(run, original))),
                ("one flipped bit", list(_flips(run, original, flips))),
            ):
                state = "closed" if closed else "open"
                rows.append([f"{state} run, {what}", sum(outcomes), f"{len(outcomes)} of {len(outcomes)}"])
    print_rows(("opened as it was, or refused with the place", "runs", "limit"), rows)


def _cuts(run: Path, original: Values) -> Iterator[bool]:
    """Yield for each cut whether it was noticed; anything but a named error ends the benchmark."""
    for name in RAW_FILES:
        content = (run / name).read_bytes()
        for kept in range(max(0, len(content) - _LAST_BYTES), len(content)):
            (run / name).write_bytes(content[:kept])
            yield is_noticed_or_unchanged(run, original)
        told(run)
        (run / name).write_bytes(content)


def _flips(run: Path, original: Values, count: int) -> Iterator[bool]:
    source = random.Random(6)
    files = sorted(path for path in run.rglob("*") if path.is_file() and path.stat().st_size)
    for _ in range(count):
        path = source.choice(files)
        content = path.read_bytes()
        changed = bytearray(content)
        changed[source.randrange(len(changed))] ^= 1 << source.randrange(8)
        path.write_bytes(changed)
        yield is_noticed_or_unchanged(run, original)
        told(run)
        path.write_bytes(content)


if __name__ == "__main__":
    print_table(int(sys.argv[1]) if len(sys.argv) > 1 else FLIPS)
