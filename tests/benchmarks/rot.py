"""Records cut at every byte of a file's last kilobyte, with a flipped bit, or changed by hand: is it always noticed?"""

import random
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from labrig.record.catalogue import list_runs
from labrig.record.pictures import Store
from labrig.record.reader import open_run
from labrig.record.run_index import INDEX_FILE
from tests.benchmarks.table import print_rows
from tests.cli.changed_records import CHANGES as KINDS
from tests.cli.changed_records import ChangedRecords, ReadOutcome, make_runs
from tests.record.faults import Values, describe_damage, full_run, is_noticed_or_unchanged, raw_files, values

FLIPS = 1000
CHANGES = 1000
_LAST_BYTES = 1024
_STORES: tuple[Store, ...] = ("png", "raw")
_NOT_RECORDED = frozenset({".lock"})
"""Names the writing process; it holds no record."""


def print_table(flips: int = FLIPS, changes: int = CHANGES) -> None:
    """Print how many changes of records were noticed."""
    _print_cuts_and_flips(flips)
    print()
    _print_changes(changes)


def _print_changes(count: int) -> None:
    """Print, for each kind of change of closed runs of every experiment, how many were named and used by no command."""
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as workspace:
        records = ChangedRecords(make_runs(Path(folder)), Path(workspace), seed=6)
        outcomes = [records.draw(number) for number in range(count)]
    print_rows(
        ("change of any file of a closed run", "made", "named by runs check", "used silently"),
        [_row_of_changes(kind, [outcome for outcome in outcomes if outcome.kind == kind]) for kind in KINDS]
        + [_row_of_changes("all", outcomes)],
    )
    for outcome in outcomes:
        if not outcome.named or outcome.used_silently:
            print(
                f"{outcome.kind} of {outcome.run}, {', '.join(outcome.files)}: {outcome.command}: {outcome.told}"
            )


def _row_of_changes(kind: str, outcomes: Sequence[ReadOutcome]) -> list[object]:
    by_root = " (with --root)" if "chain" in kind else ""
    named, used = (
        sum(outcome.named for outcome in outcomes),
        sum(outcome.used_silently for outcome in outcomes),
    )
    return [f"{kind}{by_root}", len(outcomes), f"{named} of {len(outcomes)}", used]


def _print_cuts_and_flips(flips: int) -> None:
    """Print how many cuts and flips of open and closed runs were noticed, or changed no data."""
    rows: list[list[object]] = []
    for store in _STORES:
        for closed in (False, True):
            with tempfile.TemporaryDirectory() as folder:
                run = full_run(Path(folder), closed=closed, store=store)
                name = f"{'closed' if closed else 'open'} run, {'PNG' if store == 'png' else 'raw'} frames"
                rows += _rows(name, run, store, closed, flips)
    rows.append(
        _row("index of a folder of runs: one flipped bit, the list is the same", _try_index_flips(flips))
    )
    print_rows(("opened as it was, or refused with the place", "so", "limit"), rows)


def _rows(name: str, run: Path, store: Store, closed: bool, flips: int) -> Iterator[list[object]]:
    original = values(open_run(run))
    yield _row(f"{name}: cut at each byte of a file's last kilobyte", _try_cuts(run, original, store))
    found = list(_try_flips(run, original, flips))
    yield _row(f"{name}: one flipped bit", [noticed for noticed, _ in found])
    if closed:
        yield _row(f"{name}: that bit named by runs check", [by_check for _, by_check in found])


def _row(what: str, outcomes: Iterator[bool] | list[bool]) -> list[object]:
    so = list(outcomes)
    return [what, sum(so), f"{len(so)} of {len(so)}"]


def _try_cuts(run: Path, original: Values, store: Store) -> Iterator[bool]:
    """Yield for each cut whether it was noticed; an unexpected error ends the benchmark."""
    for name in raw_files(store):
        content = (run / name).read_bytes()
        for kept in range(max(0, len(content) - _LAST_BYTES), len(content)):
            (run / name).write_bytes(content[:kept])
            yield is_noticed_or_unchanged(run, original)
        describe_damage(run)
        (run / name).write_bytes(content)


def _try_flips(run: Path, original: Values, count: int) -> Iterator[tuple[bool, bool]]:
    """Yield for each flip whether the reader noticed it, and whether the check did."""
    source = random.Random(6)
    files = sorted(path for path in run.rglob("*") if path.is_file() and path.stat().st_size)
    files = [path for path in files if path.name not in _NOT_RECORDED]
    for _ in range(count):
        path = source.choice(files)
        content = path.read_bytes()
        path.write_bytes(_flip_bit(content, source))
        yield is_noticed_or_unchanged(run, original), bool(describe_damage(run))
        path.write_bytes(content)


def _try_index_flips(count: int) -> Iterator[bool]:
    """Yield for each flip in the index of three runs whether the list stays the same."""
    source = random.Random(6)
    with tempfile.TemporaryDirectory() as folder:
        for name in ("a", "b", "c"):
            full_run(Path(folder) / name, closed=True).rename(Path(folder) / f"run-{name}")
        listed, index = list_runs(Path(folder)), Path(folder) / INDEX_FILE
        content = index.read_bytes()
        for _ in range(count):
            index.write_bytes(_flip_bit(content, source))
            yield list_runs(Path(folder)) == listed


def _flip_bit(content: bytes, source: random.Random) -> bytes:
    changed = bytearray(content)
    changed[source.randrange(len(changed))] ^= 1 << source.randrange(8)
    return bytes(changed)


if __name__ == "__main__":
    print_table(int(sys.argv[1]) if len(sys.argv) > 1 else FLIPS)
