"""Whatever is changed in a closed run, a check names it and no command uses it silently."""

from pathlib import Path

from tests.cli.changed_records import ChangedRecords, make_runs

_QUICK = ("roll-zero", "design", "import")


def test_changes_of_any_file_are_named_and_not_used(tmp_path: Path) -> None:
    """The benchmark `rot` draws 1,000 over every experiment; here are a few, of what is recorded quickly."""
    (tmp_path / "workspace").mkdir()
    records = ChangedRecords(make_runs(tmp_path / "runs", _QUICK), tmp_path / "workspace", seed=13)
    for number in range(12):
        outcome = records.draw(number)
        assert (outcome.named, outcome.used_silently) == (True, False), outcome
