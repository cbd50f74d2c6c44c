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


def _protocol(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "protocol.yaml"
    path.write_text(text, encoding="utf-8")
    return path


BROKEN = {
    "a tab in the indentation": "experiment: steerability\nneedle:\n\tneedle_id: N1\n",
    "an unclosed bracket": "experiment: steerability\nspecimens: [\n",
    "an empty file": "",
    "a list": "- experiment: steerability\n",
    "an unknown experiment": "schema_version: 1\nexperiment: steerabilty\n",
    "a python tag": "experiment: !!python/object/apply:os.system ['true']\n",
}


@pytest.mark.parametrize("text", BROKEN.values(), ids=BROKEN.keys())
def test_a_malformed_protocol_is_refused_with_its_place(text: str, labrig: Labrig, tmp_path: Path) -> None:
    """Malformed YAML exits with 2 and names the file."""
    done = labrig("run", _protocol(tmp_path, text), "--rig", RIG, "--runs-dir", tmp_path / "runs")
    assert done.exit_code == 2
    assert "protocol.yaml" in done.err
    assert "Traceback" not in done.err
    assert not (tmp_path / "runs").exists()


def test_a_file_of_another_kind_is_told_in_one_sentence(
    labrig: Labrig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rig file given as a protocol, or the other way round, is one error, not one for each key."""
    done = labrig("check", RIG)
    assert (done.exit_code, done.err.count("error:")) == (2, 1)
    assert "this is a rig file, expected a protocol" in done.err
    done = labrig("check", SWEEP, "--rig", SWEEP)
    assert (done.exit_code, done.err.count("error:")) == (2, 1)
    assert "this is a protocol, expected a rig file" in done.err
    text = tmp_path / "notes.md"
    text.write_text("# Notes\n\n- `a`: b: c\n", encoding="utf-8")
    done = labrig("run", text)
    told = f"error: {text}: this is not a YAML file\nhint: {tmp_path} holds no YAML file\n"
    assert (done.exit_code, done.err.endswith(f"\n{told}")) == (2, True)
    monkeypatch.chdir(tmp_path)
    assert "hint: this folder holds no YAML file" in labrig("run", text.name).err


def test_a_run_is_found_by_the_name_that_the_list_shows(
    labrig: Labrig, sweep: SweepRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run is found by its name in data/runs; a local folder of that name takes precedence."""
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "runs").symlink_to(sweep.run.parent, target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    near = f"{sweep.run.name}x"
    for command in (
        ("reanalyze",),
        ("report",),
        ("runs", "check"),
        ("replay",),
        ("runs", "show"),
    ):
        done = labrig(*command, near)
        assert (done.exit_code, f"did you mean {sweep.run.name}?" in done.err) == (2, True), command
    assert labrig("export", sweep.run.name, "--format", "csv", "--out", tmp_path / "tables").exit_code == 0
    assert labrig("calibrate", "template", sweep.run.name, "--out", tmp_path / "tip.png").exit_code == 0
    done = labrig("runs", "check", sweep.run.name, "--json")
    assert done.json()[0]["run"] == str(Path("data/runs") / sweep.run.name)


def test_a_misspelt_key_gets_a_suggestion(labrig: Labrig, tmp_path: Path) -> None:
    """An unknown key is named with its line and the probable key."""
    text = SWEEP.read_text(encoding="utf-8").replace("hole_spacing_mm:", "hole_spacing:")
    done = labrig("check", _protocol(tmp_path, text), "--rig", RIG, "--json")
    assert done.exit_code == 2
    assert any("hole_spacing_mm" in problem["hint"] for problem in done.json()["problems"])


def test_check_says_how_long_and_how_much(labrig: Labrig) -> None:
    """`labrig check` states the duration and the disk space of the example protocol."""
    document = labrig("check", SWEEP, "--rig", RIG, "--json").json()
    assert document["ok"] is True
    assert document["problems"] == []
    assert document["duration_s"] > 72 * 40
    assert document["disk_bytes"] > 0
    assert [age["check"] for age in document["calibration"]] == [
        "calibration intrinsics age",
        "calibration plane age",
    ]
    assert "drives and camera (labrig devices check)" in document["left_to_run"]


def test_check_refuses_a_disk_on_which_the_run_has_no_room(labrig: Labrig, tmp_path: Path) -> None:
    """So does the run: what the rig file wants to stay free counts."""
    settings = ("--rig", RIG, "--set", "rig.recording.least_free_mb=1e6")
    checked = labrig("check", SWEEP, *settings, "--json")
    assert (checked.exit_code, "MB" in checked.json()["problems"][0]["message"]) == (1, True)
    assert labrig("run", SWEEP, *settings, "--runs-dir", tmp_path).exit_code == 3


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("run nowhere.yaml", "nowhere.yaml"),
        ("runs --no-such-option", "No such option"),
        ("measure curvature text.png --px-per-mm 5 --origin-px 10 10 --insertion right", "text.png"),
        ("calibrate intrinsics a.png --board 9x6 --square-mm 25 --out taken.json", "taken.json exists"),
        ("calibrate intrinsics a.png --board 999999999x999999999 --square-mm 2", "from 3x3 to 99x99"),
    ],
)
def test_wrong_input_is_named_and_nothing_is_replaced(
    line: str, words: str, labrig: Labrig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exit code 2, and under --json an error that names the file or option."""
    monkeypatch.chdir(tmp_path)
    for name in ("text.png", "taken.json"):
        (tmp_path / name).write_text("precious")
    done = labrig(*line.split(), "--json")
    assert (done.exit_code, words in done.json()["error"]["message"]) == (2, True)
    assert (tmp_path / "taken.json").read_text() == "precious"


@pytest.mark.parametrize("number", ["nan", "inf", "-inf", "1e999"])
def test_a_number_that_is_not_finite_is_refused_by_every_command(number: str, labrig: Labrig) -> None:
    """Every command refuses NaN and infinity as an option before it asks or moves."""
    for command in (
        ("devices", "jog", "--axis", "linear", "--distance", number, "--rig", RIG),
        ("design", "--radius-mm", number),
        ("measure", "tip", "a.png", "--template", "t.png", "--near-px", 3, number),
    ):
        done = labrig(*command, "--json")
        assert (done.exit_code, done.json()["error"]["type"]) == (2, "InputError")
        assert f" is {float(number)}" in done.json()["error"]["message"]


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
    ("error", "code", "words"),
    [(MemoryError(), 3, "too little memory"), (KeyboardInterrupt(), 130, "")],
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
