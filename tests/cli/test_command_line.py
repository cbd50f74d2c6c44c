"""The command line itself: help, completion, manual, lab folders, and how a command ends."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.main import get_command

from labrig import errors
from labrig.cli.finished_run import print_finished
from labrig.cli.main import app, make_command, run_command
from labrig.cli.manual import find_pages, read_title
from labrig.cli.output import failure_document
from labrig.experiments.declared import find_experiment
from labrig.lab import RUNS_DIR_VARIABLE
from labrig.library.sources import Sources, find_recorded_rig
from labrig.runner.attendant import Attendant
from labrig.runner.conduct import Outcome
from labrig.runner.whole_run import FinishedRun, finish
from tests.cli.conftest import RIG, ROOT, SWEEP, Labrig

HEAVY = {
    "numpy", "cv2", "pandas", "scipy", "matplotlib", "rerun", "can", "canopen", "ruamel", "rich", "pydantic",
}  # fmt: skip
HEAVY |= {"labrig.experiments", "labrig.runner"}
MOST_COMMANDS, MOST_OPTIONS = 35, 150


def _walk(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    """Yield each command that does something, with its words."""
    for name, below in getattr(command, "commands", {}).items():
        yield from _walk(below, (*path, name))
    if path and (not hasattr(command, "commands") or command.invoke_without_command):
        yield " ".join(path), command


COMMANDS = dict(_walk(get_command(app)))


def test_there_are_few_commands_and_options() -> None:
    """Each command and each option is one more thing to learn."""
    parameters = [param for command in COMMANDS.values() for param in command.params]
    assert len(COMMANDS) <= MOST_COMMANDS
    assert sum(param.param_type_name == "option" for param in parameters) <= MOST_OPTIONS


@pytest.mark.parametrize("columns", [80, 52])
def test_help_names_every_command_and_fits_the_terminal(
    columns: int, labrig: Labrig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No line of the help is wider than the terminal, no word is cut, and the last line says how to start."""
    for name, value in {"COLUMNS": str(columns), "NO_COLOR": "1", "TERM": "dumb"}.items():
        monkeypatch.setenv(name, value)
    text = labrig("--help").out
    listed = {line.split()[0] for line in text.partition("Commands:")[2].splitlines() if line.strip()}
    assert {name.split()[0] for name in COMMANDS} <= listed
    assert max(len(line) for line in text.splitlines()) <= columns
    assert "labrig run steerability" in " ".join(text.split())


LIGHT: list[tuple[list[str], set[str]]] = [
    (["--help"], HEAVY),
    (["manual"], HEAVY - {"pydantic"}),
    (["runs"], HEAVY - {"pydantic"}),
    (["check", str(SWEEP), "--rig", str(RIG)], {"matplotlib", "jinja2", "rerun"}),
]
"""Command lines, and what none of them or of those before it has loaded."""


def test_help_and_lists_load_no_heavy_package() -> None:
    """Help and lists import no numpy, OpenCV or pandas; a check draws nothing."""
    code = "import sys, io, contextlib\nfrom labrig.cli.main import run_command\n" + "\n".join(
        f"with contextlib.redirect_stdout(io.StringIO()): run_command({arguments!r})\n"
        f"print({arguments[0]!r}, {unneeded!r} & set(sys.modules))"
        for arguments, unneeded in LIGHT
    )
    environment = {**os.environ, RUNS_DIR_VARIABLE: str(ROOT / "tests" / "records")}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.splitlines() == [f"{arguments[0]} set()" for arguments, _ in LIGHT]


@pytest.mark.parametrize(
    ("line", "completed"),
    [
        ("labrig resu", ["resume"]), ("labrig resume --li", ["--live"]), ("labrig runs sh", ["show"]),
        ("labrig resume ", ["last", "b", "a"]), ("labrig run proto", []),
    ],
)  # fmt: skip
def test_commands_options_and_runs_are_completed(
    line: str, completed: list[str], labrig: Labrig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Names of runs in data/runs are offered where a run is wanted; files are left to the shell."""
    for name in ("a", "b", ".hidden"):
        (tmp_path / "data" / "runs" / name).mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("_LABRIG_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(len(line.split(" ")) - 1))
    done = labrig()
    assert (done.exit_code, done.out.split()) == (0, completed)


def test_pages_of_the_manual_are_listed_and_found(labrig: Labrig) -> None:
    """Each with its title; by name, or words of title or text. Where the site was not built its source is named."""
    listed = [line.split(maxsplit=1) for line in labrig("manual").out.splitlines()[1:]]
    assert listed == [[name, read_title(page)] for name, page in find_pages().items()]
    for asked in (["run-format"], ["reference/run-format.md"], ["format", "run"], ["fsync_period_s"]):
        assert labrig("manual", *asked).out.startswith(f"page: {find_pages()['run-format']}; read it in ")


@pytest.fixture
def lab(labrig: Labrig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make a lab folder, and work in it."""
    monkeypatch.chdir(tmp_path)
    for name in (RUNS_DIR_VARIABLE, "LABRIG_RIG"):
        monkeypatch.delenv(name, raising=False)
    made = labrig("init", "my lab", "--json")
    assert made.exit_code == 0
    assert "protocols/steerability.yaml" in made.json()["written"]
    monkeypatch.chdir(tmp_path / "my lab")
    return tmp_path / "my lab"


def test_a_protocol_is_named_in_any_folder_of_the_lab(
    lab: Path, labrig: Labrig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Protocol, rig, calibration and runs are those of the lab folder; what was probably meant is named."""
    (lab / "data/runs/calibration").mkdir()
    assert "data/runs/calibration is no run" in labrig("report", "calibration").err
    monkeypatch.chdir(lab / "data")
    checked = labrig("check", "steerability", "--json")
    assert (checked.exit_code, checked.json()["ok"]) == (0, True)
    assert checked.err.strip() == f"runs: ../data/runs, in the lab folder {lab}"
    assert "did you mean steerability?" in labrig("run", "sterability").err
    listed = labrig("runs").err.splitlines()
    assert listed[-1].startswith(f"no runs in ../data/runs, in the lab folder {lab}; make")


def test_a_manifest_names_its_sources_from_the_lab_folder(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Wherever in the lab folder a run was started, it can be resumed from any other folder."""
    monkeypatch.chdir(lab / "data")
    typed = Sources(Path("../protocols/design.yaml"), Path("../calibration/rig-simulated.yaml"), (), None)
    kept = typed.document(has_rig=True)
    assert (kept["protocol"], kept["rig"]) == ("protocols/design.yaml", "calibration/rig-simulated.yaml")
    monkeypatch.chdir(lab.parent)
    rig, _ = find_recorded_rig(Path("my lab/data/runs/one"), {"sources": kept})
    assert rig is not None
    assert rig.samefile(lab / "calibration/rig-simulated.yaml")
    for elsewhere in (lab.parent / "a.yaml", Path("../a.yaml")):
        assert Sources(elsewhere, None, (), None).document(has_rig=False)["protocol"] == str(elsewhere)


def test_the_folder_of_the_runs_may_be_set_for_a_session(
    lab: Path, labrig: Labrig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Commands say so; without a lab folder the list says where it has looked, and nothing is made."""
    monkeypatch.setenv(RUNS_DIR_VARIABLE, "elsewhere")
    assert labrig("runs").err.startswith("runs: elsewhere, as LABRIG_RUNS_DIR says")
    assert "there is no run one, neither here nor in elsewhere" in labrig("report", "one").err
    monkeypatch.delenv(RUNS_DIR_VARIABLE)
    monkeypatch.chdir(lab.parent)
    listed = labrig("runs").err
    assert "no runs in data/runs, below the working folder, as no lab folder is here or above" in listed
    assert list(lab.parent.iterdir()) == [lab]


def test_the_schemas_of_a_lab_folder_are_where_its_files_name_them(lab: Path) -> None:
    """An editor completes each YAML file by its first line, and new files by the settings."""
    settings = json.loads((lab / ".vscode/settings.json").read_text(encoding="utf-8"))
    assert all((lab / schema).is_file() for schema in settings["yaml.schemas"])
    for file in (*lab.glob("protocols/*.yaml"), *lab.glob("calibration/*.yaml")):
        named = file.read_text(encoding="utf-8").splitlines()[0].partition("$schema=")[2]
        assert (file.parent / named).is_file(), file


def _fail(error: BaseException) -> int:
    """Return the exit code of a command that raises an error."""
    app = typer.Typer()

    @app.command()
    @make_command
    def fail() -> None:
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


def test_what_a_library_raises_is_told_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    """Running out of memory is neither a bug nor wrong input; an interruption counts as a signal."""
    assert (_fail(MemoryError()), _fail(KeyboardInterrupt())) == (3, 130)
    assert "interrupted by SIGINT" in capsys.readouterr().err.partition("too little memory")[2]


@pytest.mark.parametrize(
    ("error", "name", "code"),
    [
        (errors.BusError("gone"), "bus-lost", 0x8100),
        (errors.BusPassiveError("passive"), "error-passive", 0x8120),
        (errors.BusOffError("off"), "bus-off", 0x81FD),
        (errors.DriveRestartedError("restarted"), "boot-up", 0),
        (errors.DriveSilentError("mute"), "no-answer", 0x05040000),
        (
            errors.DriveFaultError("hot", fault=errors.Fault("emergency", 0x4210, 8, "too hot")),
            "emergency",
            0x4210,
        ),
    ],
)
def test_a_fault_of_bus_or_drive_has_its_name_and_code_in_json(
    error: errors.LabrigError, name: str, code: int
) -> None:
    """`error.fault` holds a stable name, the code of the manuals, the register bit and a text."""
    fault = failure_document(error)["fault"]
    assert isinstance(fault, dict)
    assert (fault["name"], fault["code"], set(fault)) == (name, code, {"name", "code", "register", "text"})
    assert fault["text"]
    assert set(failure_document(errors.DiskError("full", "make room"))) == {"type", "message", "hint"}


@pytest.mark.parametrize(
    ("result", "exit_code"),
    [
        ({"reached": True}, 0), ({"reached": False}, 1), ({"reached": None}, 1), ({"accepted": False}, 1),
        ({}, 0),
    ],
)  # fmt: skip
def test_only_a_result_that_says_yes_ends_with_zero(
    result: dict[str, object], exit_code: int, tmp_path: Path
) -> None:
    """A target that is not known to have been reached is no success, nor is one that was missed."""
    finished = FinishedRun(tmp_path, Outcome("success", "", None), result=result)
    assert print_finished(finished, None) == exit_code


def test_a_target_that_was_missed_is_told_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Page and terminal use the same words; of the error only what to do is said."""
    report, error = tmp_path / "page", errors.TargetMissedError("2 mm off", "move the target")
    report.write_text('<p class="verdict">Not reached: <b>2 mm</b> off.</p><p>More</p>', encoding="utf-8")
    finished = FinishedRun(tmp_path, Outcome("failed", "", error), result={"reached": False}, report=report)
    assert print_finished(finished, find_experiment("roll-zero")) == 1
    printed = capsys.readouterr()
    assert printed.out.startswith("Not reached: 2 mm off.\nrecord  ")
    assert printed.err == "hint: move the target\nsee: labrig manual steer-to-target\n"


class Interrupting(Attendant):
    """Presses Ctrl+C when it is told that the report is written."""

    def say(self, text: str) -> None:
        """Press it."""
        if text == "writing the report":
            raise KeyboardInterrupt


def test_ctrl_c_after_the_end_says_that_the_run_is_recorded(tmp_path: Path) -> None:
    """And which command writes the page; a result that was made is kept."""
    path = Path(shutil.copytree(ROOT / "tests" / "records" / "roll-zero", tmp_path / "run"))
    before = len(list((path / "analysis").iterdir()))
    ended = FinishedRun(path, Outcome("success", "", None))
    finished = finish(ended, find_experiment("roll-zero"), ("labrig",), Interrupting())
    assert "it is recorded; labrig reanalyze measures it and writes its page" in finished.outcome.reason
    assert (finished.outcome.exit_status, finished.report) == ("success", None)
    assert len(list((path / "analysis").iterdir())) == before + 1
