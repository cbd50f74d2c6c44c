"""Every example protocol, and imported pictures, through every command that takes a run."""

import hashlib
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.cli.conftest import RIG, Labrig
from tests.cli.cut_runs import cut_short
from tests.cli.example_runs import EXAMPLES, SHORTENED, make_example, of_protocol
from tests.record.runs import flip_bit
from tests.runner.sessions import EXAMPLES as PROTOCOL_NAMES

FORMATS = {
    "csv": "frames.csv",
    "parquet": "frames.parquet",
    "matlab": "run.mat",
    "record": "manifest.json",
}


@dataclass(frozen=True)
class Made:
    """A run that was made once, and what the command that made it printed."""

    name: str
    run: Path
    document: dict[str, Any]


@pytest.fixture(scope="session", params=EXAMPLES)
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Return a run of each experiment that has come to its end."""
    run, document = make_example(request.param, tmp_path_factory.mktemp("runs"))
    return Made(request.param, run, document)


@pytest.fixture
def run(made: Made, tmp_path: Path) -> Path:
    """Return a copy of a finished run that a test may write into."""
    return Path(shutil.copytree(made.run, tmp_path / "runs" / "copy"))


@pytest.fixture
def killed(made: Made, tmp_path: Path) -> Path:
    """Return the same run as a power cut in the middle of it leaves it."""
    lines = "frames.jsonl" if made.name == "import" else "events.jsonl"
    times_s = [float(t_s) for t_s in re.findall(r'"t_s":\s*([-+.e\d]+)', (made.run / lines).read_text())]
    (tmp_path / "runs").mkdir()
    return cut_short(made.run, tmp_path / "runs" / "killed", (times_s[0] + times_s[-1]) / 2)


Sound = Callable[[Path, str], None]


@pytest.fixture
def is_sound(labrig: Labrig) -> Sound:
    """Check that a run is called sound, closed with a status, and nothing of it torn."""

    def check(run: Path, exit_status: str) -> None:
        done = labrig("runs", "check", run, "--json")
        (row,) = done.json()
        verdict = (row["ok"], row["damage"], row["notices"], row["exit_status"])
        assert (done.exit_code, *verdict) == (0, True, [], [], exit_status)

    return check


def test_every_example_protocol_is_run_here() -> None:
    """A new protocol file must pass every command too."""
    assert sorted(SHORTENED) == PROTOCOL_NAMES


@pytest.mark.parametrize("name", SHORTENED)
def test_check_finds_no_problem(name: str, labrig: Labrig) -> None:
    """The dry run of each example has no problems."""
    done = labrig("check", *of_protocol(name), "--json")
    assert (done.exit_code, done.json()["ok"], done.json()["problems"]) == (0, True, [])


def test_a_run_is_sound(made: Made, is_sound: Sound) -> None:
    """A successful run is reported sound."""
    assert made.document.get("exit_status", "success") == "success"
    is_sound(made.run, "success")


def test_a_run_replays_identically(made: Made, labrig: Labrig) -> None:
    """To the last bit; imported pictures were made by no procedure, and the command says so."""
    done = labrig("replay", made.run, "--json")
    if made.name == "import":
        assert (done.exit_code, done.json()["error"]["hint"]) == (2, "there is nothing to replay")
    else:
        replay = done.json()
        assert (done.exit_code, replay["verdict"]) == (0, "identical")


# A design takes long to compute again; its numbers are those of the record kept in test_kept_records.
@pytest.mark.parametrize("made", [name for name in EXAMPLES if name != "design"], indirect=True)
def test_a_run_is_measured_again_with_the_same_numbers(made: Made, run: Path, labrig: Labrig) -> None:
    """The new result equals the first one, and the record stays sound."""
    for parent in range(2) if made.name == "import" else (1,):
        done = labrig("reanalyze", run, "--json")
        (row,) = done.json()
        assert (done.exit_code, row["ok"], row["reason"]) == (0, True, None)
        assert (row["parent"] or 0, row["first_difference"]) == (parent, None)
    assert labrig("runs", "check", run).exit_code == 0


def test_a_run_is_shown(run: Path, labrig: Labrig) -> None:
    """The page and the view are written."""
    (run / "report.html").unlink(missing_ok=True)
    (row,) = labrig("report", run, "--json").json()
    assert (row["ok"], row["reason"], Path(row["report"])) == (True, None, run / "report.html")
    done = labrig("view", run, "--json")
    assert (done.exit_code, done.json()["ok"], done.json()["reason"]) == (0, True, None)
    assert (run / "view.rrd").stat().st_size > 0


@pytest.mark.parametrize("form", FORMATS)
def test_a_run_is_exported(form: str, made: Made, tmp_path: Path, labrig: Labrig, is_sound: Sound) -> None:
    """Each format is complete; a copy of the record is sound."""
    out = tmp_path / "out"
    done = labrig("export", made.run, "--format", form, "--out", out, "--json")
    assert (done.exit_code, done.json()["ok"]) == (0, True)
    assert FORMATS[form] in done.json()["files"]
    if form == "record":
        is_sound(out, "success")


def test_changed_pictures_are_named_and_not_used(
    made: Made, run: Path, tmp_path: Path, labrig: Labrig
) -> None:
    """Whatever they show, a flipped bit ends each command that reads the pictures with 4 and a name."""
    pictures = sorted((run / "frames").iterdir())
    if not pictures:
        pytest.skip("a design has no pictures")
    for picture in pictures:
        flip_bit(picture)
    copy = ("export", run, "--format", "record", "--out", tmp_path / "copy")
    for words in (("reanalyze", run), ("view", run, "--json"), ("runs", "check", run), copy):
        done = labrig(*words)
        named = any(picture.name in done.out + done.err for picture in pictures)
        assert (done.exit_code, named) == (4, True), words


def test_annotations_appear_in_the_list(run: Path, labrig: Labrig, is_sound: Sound) -> None:
    """Tag, note and verdict are in the list of runs, and the record stays sound."""
    said = ("--tag", "kept", "--note", "look again", "--verdict", "good", "--by", "Ada")
    assert labrig("runs", "annotate", run, *said).exit_code == 0
    (row,) = labrig("runs", "--runs-dir", run.parent, "--where", "tag=kept", "--json").json()
    assert (Path(row["run"]), row["tags"], row["notes"], row["verdict"]) == (run, ["kept"], 1, "good")
    is_sound(run, "success")


def test_the_checksum_of_a_run_stays(run: Path, labrig: Labrig, made: Made) -> None:
    """It is printed when the run ends, for a notebook, and is the SHA-256 of SHA256SUMS ever after."""
    labrig("runs", "annotate", run, "--note", "later")
    printed = hashlib.sha256((run / "SHA256SUMS").read_bytes()).hexdigest()
    assert made.document["checksum"] == printed


def test_what_a_run_found_is_adopted_or_refused(
    made: Made, run: Path, tmp_path: Path, labrig: Labrig, is_sound: Sound
) -> None:
    """A calibration goes to the rig's files; it replaces one with --force alone; other runs have none."""
    rig = tmp_path / "rig.yaml"
    rig.write_text(RIG.read_text(encoding="utf-8"), encoding="utf-8")
    adopted = labrig("calibrate", "adopt", run, "--rig", rig)
    if made.name == "calibration":
        plane = tmp_path / "simulated-plane.json"
        assert (adopted.exit_code, plane.exists()) == (0, True)
        again = labrig("calibrate", "adopt", run, "--rig", rig)
        assert (again.exit_code, "replace the old one with --force" in again.err) == (2, True)
        forced = labrig("calibrate", "adopt", run, "--rig", rig, "--force")
        assert (forced.exit_code, "mm wide" in forced.out) == (0, True)
    else:
        assert (adopted.exit_code, "holds no calibration" in adopted.err) == (4, True)
    is_sound(run, "success")


def test_a_finished_run_that_is_resumed_is_only_measured_again(
    run: Path, labrig: Labrig, is_sound: Sound
) -> None:
    """Nothing moves; there is one more result, and the record stays sound."""
    results = len(list((run / "analysis").iterdir())) if (run / "analysis").exists() else 0
    done = labrig("resume", run, "--json")
    assert (done.exit_code, done.json()["exit_status"]) == (0, "success")
    assert len(list((run / "analysis").iterdir())) == results + 1
    is_sound(run, "success")


def test_a_killed_run_is_read_by_every_command(
    made: Made, killed: Path, tmp_path: Path, labrig: Labrig
) -> None:
    """It can be checked, replayed, measured, shown, exported and annotated."""
    assert labrig("replay", killed).exit_code == (2 if made.name == "import" else 0)
    measured = labrig("reanalyze", killed)
    if made.name == "roll-zero":
        assert (measured.exit_code, "four of each are the least" in measured.err) == (2, True)
    else:
        assert measured.exit_code == 0
    for words in (
        ("report", killed),
        ("view", killed, "--json"),
        ("export", killed, "--format", "csv", "--format", "matlab", "--out", tmp_path / "out"),
        ("export", killed, "--format", "record", "--out", tmp_path / "copy"),
        ("runs", "check", tmp_path / "copy"),
        ("runs", "annotate", killed, "--tag", "killed", "--note", "cut short", "--verdict", "doubtful"),
        ("runs", "show", killed),
        ("runs", "check", killed),
    ):
        assert labrig(*words).exit_code == 0, words


def test_a_killed_run_goes_on_or_says_why_not(
    made: Made, killed: Path, labrig: Labrig, is_sound: Sound
) -> None:
    """A sweep and an insertion are completed; other runs cannot be continued and stay unchanged."""
    done = labrig("resume", killed, "--json")
    if made.name in {"steerability", "insertion"}:
        assert (done.exit_code, done.json()["exit_status"]) == (0, "success")
        is_sound(killed, "success")
    else:
        assert done.exit_code == 2
        assert "nothing of it can be kept" in done.json()["error"]["message"]
        assert labrig("runs", "check", killed).exit_code == 0
