"""`labrig pause` and `labrig continue`, while a run looks for requests."""

from pathlib import Path

import pytest

from labrig.cli.attendant import TerminalAttendant
from labrig.cli.signals import SignalNote
from tests.cli.conftest import Labrig
from tests.record.runs import ENDED, begin


def test_a_run_is_paused_and_continued_by_commands(
    labrig: Labrig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its terminal says when the pause begins; a run that is not paused, or over, exits with 2."""
    recorder, note = begin(tmp_path), SignalNote()
    with TerminalAttendant().take_requests(note, recorder.path) as requests:
        done = labrig("pause", recorder.path, "--json")
        assert (done.exit_code, "next safe point" in done.json()["answer"]) == (0, True)
        assert requests.find("trial_end") == "labrig pause"
        requests.announce("after this insertion")
        assert "labrig pause: pausing after this insertion" in capsys.readouterr().err
        requests.begin()
        done = labrig("continue", recorder.path)
        assert (done.exit_code, done.out) == (0, "the run continues\n")
        assert requests.find_continuation() == "labrig continue"
        requests.end()
        assert requests.find("question") is None
        refused = labrig("continue", recorder.path)
        assert (refused.exit_code, "the run is not paused" in refused.err) == (2, True)
    recorder.close("success", "", ENDED)
    over = labrig("pause", recorder.path, "--json")
    assert (over.exit_code, over.json()["error"]["type"]) == (2, "InputError")
    assert labrig("pause", tmp_path).exit_code == 4


def test_ctrl_c_is_announced_once_and_met_by_a_pause(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The request stands until the pause begins; the next Ctrl+C is a new one."""
    recorder, note = begin(tmp_path), SignalNote()
    with (
        TerminalAttendant().take_requests(note, recorder.path) as requests,
        note.pausing(enabled=True),  # as at a terminal
    ):
        for _ in range(2):
            note.take(2, None)
            assert requests.find("trial_end") == "Ctrl+C"
            requests.announce("after this insertion")
            requests.announce("after this insertion")
            requests.begin()
            requests.end()
            assert requests.find("trial_end") is None
            assert capsys.readouterr().err.count("Ctrl+C: pausing after this insertion; Ctrl+C again") == 1
    recorder.close("success", "", ENDED)
