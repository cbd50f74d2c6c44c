"""`labrig specimens`, and runs in a block of gel that has a file."""

import json
from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path

import pytest

from labrig.devices.clocks import SystemClock
from labrig.record.reader import open_run
from tests.cli.conftest import SMALL_RIG, Labrig
from tests.cli.cut_runs import cut_short
from tests.protocol.specimens import CAST_ON, sweep_in, write_specimen

SHORT = (
    *SMALL_RIG, "--set", "insertions_per_specimen=1", "--set", "insertion.length_mm=22",
    "--set", "insertion.speed_mm_s=5", "--set", "insertion.frame_every_mm=20",
)  # fmt: skip


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a working folder of its own."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def begin_at(place_mm: float) -> tuple[str, ...]:
    """Return the options for the first hole of a run."""
    return "--set", f"specimens.0.first_hole_mm={place_mm}"


def list_places_mm(run: Path) -> Sequence[float]:
    """Return the entry points of a run [mm]."""
    return list(open_run(run).trials["hole_position_mm"])


def test_a_second_run_keeps_off_the_tracks_of_the_first(bench: Path, labrig: Labrig) -> None:
    """The first run's hole is refused, the proposed one is clear, and both are listed."""
    write_specimen(bench, lines="batch: <b>7</b>\n")
    protocol = sweep_in(bench, "specimen_file: A1")
    assert labrig("run", protocol, *SHORT, "--run-name", "one", "--json").exit_code == 0
    checked = labrig("check", protocol, *SHORT, "--json")
    (problem,) = checked.json()["problems"]
    assert (checked.exit_code, problem["where"]) == (1, "specimens.0.first_hole_mm")
    assert "would be 0.00 mm from hole 1 of run one, at 0 mm" in problem["message"]
    refused = labrig("run", protocol, *SHORT, "--run-name", "none")
    assert (refused.exit_code, (bench / "data/runs/none").exists()) == (2, False)
    place_mm = float(problem["hint"].split("first_hole_mm: ")[1].split(" ")[0])
    made = labrig("run", protocol, *SHORT, *begin_at(place_mm), "--run-name", "two", "--json")
    assert made.exit_code == 0
    run = bench / "data" / "runs" / "two"
    assert list_places_mm(run) == [place_mm]
    shown = labrig("specimens", "A1", "--json").json()
    assert [track["hole_position_mm"] for track in shown["tracks"]["simulated"]] == [0.0, place_mm]
    assert shown["tracks"]["real"] == []
    assert "\ntracks of simulated runs:\n" in labrig("specimens", "A1").out
    assert labrig("replay", run, "--json").json()["identical"] is True
    assert labrig("reanalyze", run).exit_code == 0
    assert labrig("export", run, "--format", "csv", "--out", bench / "tables").exit_code == 0
    _resume_beside(run, labrig, place_mm)


def _resume_beside(run: Path, labrig: Labrig, place_mm: float) -> None:
    """A run that was cut short in its insertion resumes, and makes it again clear of the old tracks."""
    start_s = float(open_run(run).trials["start_t_s"][0])
    cut = cut_short(run, run.with_name("cut"), start_s + 8.0)
    assert labrig("resume", cut, "--json").exit_code == 0
    assert list_places_mm(cut) == [place_mm, place_mm + 10.0]


def test_a_block_that_is_not_of_an_age_to_be_used_is_refused(bench: Path, labrig: Labrig) -> None:
    """Cast in the future and past its time are refused with both times; one that still cures is warned of."""
    protocol = sweep_in(bench, "specimen_file: A1")
    write_specimen(bench, lines="usable_until: 2026-11-21T09:30+01:00\n")
    late = labrig("check", protocol, *SHORT)
    assert (late.exit_code, "was usable until 2026-11-21T09:30+01:00" in late.out) == (1, True)
    assert labrig("run", protocol, *SHORT).exit_code == 2
    path = write_specimen(bench)
    path.write_text(path.read_text().replace("2026", "9026"), encoding="utf-8")
    early = labrig("check", protocol, *SHORT)
    assert (early.exit_code, "was cast on 9026-11-20T09:30+01:00, and now" in early.out) == (1, True)
    hour_ago = SystemClock().utc() - timedelta(hours=1)
    path = write_specimen(bench, "A2", "cured_for_h: 24\n")
    path.write_text(
        path.read_text().replace(CAST_ON, hour_ago.isoformat(timespec="minutes")), encoding="utf-8"
    )
    curing = labrig("check", protocol, *SHORT, "--set", "specimens.0.specimen_file=A2")
    assert (curing.exit_code, "cures for 24 h by its file" in curing.out) == (0, True)


def test_specimens_are_listed_and_shown(bench: Path, labrig: Labrig) -> None:
    """A file that cannot be read is named; of a name that no specimen has, the nearest one is."""
    assert labrig("specimens").err.startswith("no specimens in data/specimens")
    write_specimen(bench)
    (bench / "data/specimens/B1.yaml").write_text("name: [", encoding="utf-8")
    listed = labrig("specimens", "--json")
    assert [row["name"] for row in json.loads(listed.out)] == ["A1"]
    assert "B1.yaml" in listed.err
    assert "did you mean A1?" in labrig("specimens", "A11").err
