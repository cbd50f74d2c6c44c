"""Errors for bad input: a sentence that names the cause, a hint, the documented exit code, and no traceback."""

import json
import os
from pathlib import Path
from typing import Annotated

import pytest
import typer

from labrig.cli.main import run_command
from labrig.cli.output import failure_document
from labrig.errors import (
    BusError,
    BusOffError,
    BusPassiveError,
    DiskError,
    DriveFaultError,
    DriveRestartedError,
    DriveSilentError,
    Fault,
    LabrigError,
)
from tests.cli.conftest import RIG, SWEEP, Labrig, SweepRun


def test_a_run_is_found_by_the_name_that_the_list_shows(
    labrig: Labrig, sweep: SweepRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run is found by its name in data/runs; a local folder of that name takes precedence."""
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "runs").symlink_to(sweep.run.parent, target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    near = f"{sweep.run.name}x"
    for command in (("reanalyze",), ("report",), ("runs", "check"), ("replay",), ("runs", "show")):
        done = labrig(*command, near)
        assert (done.exit_code, f"did you mean {sweep.run.name}?" in done.err) == (2, True), command
    assert labrig("export", sweep.run.name, "--format", "csv", "--out", tmp_path / "tables").exit_code == 0
    assert labrig("calibrate", "template", sweep.run.name, "--out", tmp_path / "tip.png").exit_code == 0
    done = labrig("runs", "check", sweep.run.name, "--json")
    assert done.json()[0]["run"] == str(Path("data/runs") / sweep.run.name)


def test_check_says_how_long_and_how_much(labrig: Labrig) -> None:
    """`labrig check` states the duration and the disk space of the example protocol."""
    document = labrig("check", SWEEP, "--rig", RIG, "--json").json()
    assert document["ok"] is True
    assert document["problems"] == []
    assert document["duration_s"] > 72 * 40
    assert 0.5 < document["disk_bytes"] / (72 * 10 * 1280 * 720) < 1.0  # ten pictures a trial
    assert [age["check"] for age in document["calibration"]] == [
        "calibration intrinsics age",
        "calibration plane age",
    ]
    assert "drives and camera (labrig devices check)" in document["left_to_run"]


def test_a_named_pipe_holds_up_no_command(labrig: Labrig, tmp_path: Path) -> None:
    """A named pipe in place of a file is refused at once, also in a list of runs."""
    pipe = tmp_path / "runs" / "one" / "manifest.json"
    pipe.parent.mkdir(parents=True)
    (pipe.parent / "protocol.yaml").touch()
    os.mkfifo(pipe)
    deep = tmp_path / "runs" / "two" / "manifest.json"
    deep.parent.mkdir()
    (deep.parent / "protocol.yaml").touch()
    deep.write_text("[" * 200_000)  # a list of brackets, which a parser would recurse into
    rows = labrig("runs", "--runs-dir", tmp_path / "runs", "--json").json()
    assert [row["exit_status"] for row in rows] == ["damaged", "damaged"]
    refused = (
        ("check", pipe, 2, "a pipe"),
        ("report", pipe.parent, 4, "is no run"),
        ("plan", pipe, 2, "a pipe"),
    )
    for command, path, code, words in refused:
        done = labrig(command, path)
        assert (done.exit_code, words in done.err) == (code, True), command


def _fail(error: BaseException) -> int:
    """Return the exit code of a command that raises an error."""
    app = typer.Typer()

    @app.command()
    def fail(_as_json: Annotated[bool, typer.Option("--json")] = False) -> None:
        raise error

    return run_command(["--json"], app)


@pytest.mark.parametrize("bug", [KeyError("roll"), RecursionError("too deep")])
def test_a_bug_has_a_code_of_its_own_and_leaves_its_traceback_in_a_file(
    bug: Exception, capsys: pytest.CaptureFixture[str]
) -> None:
    """A bug exits with 5, prints one sentence, and leaves its traceback in the named file."""
    assert _fail(bug) == 5
    printed = capsys.readouterr()
    error = json.loads(printed.out)["error"]
    assert error["type"] == "BugError"
    file = Path(error["hint"].rpartition(" ")[2])
    try:
        assert "Traceback (most recent call last)" in file.read_text()
    finally:
        file.unlink()
    assert "Traceback" not in printed.err


@pytest.mark.parametrize(
    ("error", "code", "words"), [(MemoryError(), 3, "too little memory"), (KeyboardInterrupt(), 130, "")]
)
def test_what_a_library_raises_is_told_in_words(
    error: BaseException, code: int, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Running out of memory is neither a bug nor wrong input; an interruption counts as a signal."""
    assert _fail(error) == code
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "name", "code"),
    [
        (BusError("gone"), "bus-lost", 0x8100),
        (BusPassiveError("passive"), "error-passive", 0x8120),
        (BusOffError("off"), "bus-off", 0x81FD),
        (DriveRestartedError("restarted"), "boot-up", 0),
        (DriveSilentError("mute"), "no-answer", 0x05040000),
        (
            DriveFaultError("hot", fault=Fault("emergency", 0x4210, 8, "over-temperature")),
            "emergency",
            0x4210,
        ),
    ],
)
def test_a_fault_of_bus_or_drive_has_its_name_and_code_in_json(
    error: LabrigError, name: str, code: int
) -> None:
    """`error.fault` holds a stable name, the code of the manuals, the register bit and a text."""
    fault = failure_document(error)["fault"]
    assert isinstance(fault, dict)
    assert (fault["name"], fault["code"]) == (name, code)
    assert set(fault) == {"name", "code", "register", "text"}
    assert fault["text"]
    assert set(failure_document(DiskError("full", "make room"))) == {"type", "message", "hint"}
