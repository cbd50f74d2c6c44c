"""Whatever is changed in a closed run, a check names it and no command uses it silently."""

import shutil
from pathlib import Path

import pytest

from tests.cli.changed_records import ChangedRecords, make_runs
from tests.cli.conftest import Labrig

_QUICK = ("roll-zero", "import")


@pytest.fixture(scope="module")
def closed(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Return runs that are closed, measured and annotated; each test changes copies."""
    return make_runs(tmp_path_factory.mktemp("runs"), _QUICK)


def test_what_lost_its_link_is_named_by_each_command_that_leaves_it_out(
    closed: list[Path], tmp_path: Path, labrig: Labrig
) -> None:
    """The chain ends before the newest result and the notes: pages and tables are made without them, and say so."""
    run = Path(shutil.copytree(closed[0], tmp_path / "run"))
    chain = (run / "chain.jsonl").read_bytes().splitlines(keepends=True)
    first = next(number for number, line in enumerate(chain) if b'"kind":"result"' in line)
    (run / "chain.jsonl").write_bytes(b"".join(chain[:first]))
    for words in (
        ("report", run),
        ("export", run, "--csv", "--out", tmp_path / "tables"),
        ("view", run, "--no-open"),
    ):
        done = labrig(*words)
        assert done.exit_code == 0
        assert "note: analysis/001: this result has no link in chain.jsonl and is not used" in done.err
        assert "note: notes.jsonl: its last 4 lines have no link in chain.jsonl and are not used" in done.err


def test_changes_of_any_file_are_named_and_not_used(closed: list[Path], tmp_path: Path) -> None:
    """The benchmark `rot` draws 1,000 over every experiment; here are a few, of what is recorded quickly."""
    records = ChangedRecords(closed, tmp_path, seed=13)
    for number in range(12):
        outcome = records.draw(number)
        assert (outcome.named, outcome.used_silently) == (True, False), outcome
