"""`labrig runs log`."""

import shutil
from pathlib import Path

from tests.cli.conftest import ROOT, Labrig

_SWEEP = ROOT / "tests" / "records" / "steerability"


def test_the_log_of_a_run_is_its_events_in_words(labrig: Labrig) -> None:
    """Each has its rig time; the moves of the axes are told when they are asked for."""
    printed = labrig("runs", "log", _SWEEP).out.splitlines()
    assert printed[0] == "    1.200 s  run starts: steerability"
    assert printed[-1] == "   26.910 s  run succeeded"
    every = labrig("runs", "log", _SWEEP, "--all").out.splitlines()
    assert set(printed) < set(every)
    assert any("insertion moves to" in line for line in every)


def test_the_log_is_one_document_too(labrig: Labrig) -> None:
    """The first events can be left out, as a program does that has read them."""
    every = labrig("runs", "log", _SWEEP, "--json").json()["events"]
    assert every[0] == {
        "t_s": 1.2,
        "kind": "run_start",
        "level": "INFO",
        "text": "run starts: steerability",
    }
    assert labrig("runs", "log", _SWEEP, "--skip", "1", "--json").json()["events"] == every[1:]


def test_following_a_run_that_has_ended_ends(labrig: Labrig) -> None:
    """It prints what the log prints; one document it cannot make."""
    assert labrig("runs", "log", _SWEEP, "--follow").out == labrig("runs", "log", _SWEEP).out
    assert labrig("runs", "log", _SWEEP, "--follow", "--json").exit_code == 2


def test_the_log_of_a_damaged_run_says_so(labrig: Labrig, tmp_path: Path) -> None:
    """What can be read is told, and the command ends with 4."""
    run = shutil.copytree(_SWEEP, tmp_path / "run")
    next((run / "frames").iterdir()).unlink()
    done = labrig("runs", "log", run)
    assert done.exit_code == 4
    assert "run starts: steerability" in done.out
    assert "missing" in done.err
