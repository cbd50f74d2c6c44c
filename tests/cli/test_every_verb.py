"""Every example protocol, and imported pictures, through every command that takes a run."""

import hashlib
import re
import shlex
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

VERBS = {
    "report RUN": "RUN/report.html",
    "view RUN --json": "RUN/view.rrd",
    "export RUN --format csv --format parquet --format matlab --out OUT/tables": "OUT/tables/frames.parquet",
    "export RUN --format record --out OUT/copy": "OUT/copy/manifest.json",
    "runs check OUT/copy": "OUT/tables/run.mat",
    "runs annotate RUN --tag kept --note 'look again' --verdict good --by Ada": "RUN/notes.json",
    "runs show RUN": "OUT/tables/frames.csv",
}
"""What succeeds with any run, and a file that is there then."""


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
    (tmp_path / "runs").mkdir(exist_ok=True)
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


def use_every_verb(run: Path, out: Path, labrig: Labrig) -> None:
    """Have each verb use a run, and look for its file."""
    for words, file in VERBS.items():
        line = words.replace("RUN", shlex.quote(str(run))).replace("OUT", shlex.quote(str(out)))
        assert labrig(*shlex.split(line)).exit_code == 0, words
        assert Path(file.replace("RUN", str(run)).replace("OUT", str(out))).stat().st_size > 0, words


def test_every_example_protocol_is_run_here() -> None:
    """A new protocol file must pass every command too."""
    assert sorted(SHORTENED) == PROTOCOL_NAMES


@pytest.mark.parametrize("name", SHORTENED)
def test_check_finds_no_problem(name: str, labrig: Labrig) -> None:
    """The dry run of each example has no problems."""
    done = labrig("check", *of_protocol(name), "--json")
    assert (done.exit_code, done.json()["ok"], done.json()["problems"]) == (0, True, [])


def test_a_run_replays_identically(made: Made, labrig: Labrig) -> None:
    """To the last bit; imported pictures were made by no procedure, and the command says so."""
    if made.name == "design":
        pytest.skip("it is a kept record, which another processor may have made")
    assert made.document.get("exit_status", "success") == "success"
    done = labrig("replay", made.run, "--json")
    if made.name == "import":
        assert (done.exit_code, done.json()["error"]["hint"]) == (2, "there is nothing to replay")
    else:
        assert (done.exit_code, done.json()["verdict"]) == (0, "identical")


def test_every_verb_takes_a_finished_run(
    made: Made, run: Path, tmp_path: Path, labrig: Labrig, is_sound: Sound
) -> None:
    """It stays sound, and its checksum is the one that was printed when it ended; what is said of it is found."""
    use_every_verb(run, tmp_path / "out", labrig)
    assert made.document["checksum"] == hashlib.sha256((run / "SHA256SUMS").read_bytes()).hexdigest()
    (row,) = labrig("runs", "--runs-dir", run.parent, "--where", "tag=kept", "--json").json()
    assert (Path(row["run"]), row["tags"], row["notes"], row["verdict"]) == (run, ["kept"], 1, "good")
    is_sound(run, "success")
    is_sound(tmp_path / "out" / "copy", "success")


def test_every_verb_takes_a_killed_run(made: Made, killed: Path, tmp_path: Path, labrig: Labrig) -> None:
    """It can be checked, replayed, measured, shown, exported and annotated."""
    if made.name != "design":  # takes long to compute
        assert labrig("replay", killed).exit_code == (2 if made.name == "import" else 0)
        assert (
            labrig("reanalyze", killed).exit_code == 0
        )  # a roll zero by too few rolls is a result that says no
    use_every_verb(killed, tmp_path / "out", labrig)
    assert labrig("runs", "check", killed).exit_code == 0


def test_a_run_goes_on_or_says_why_not(
    made: Made, run: Path, killed: Path, labrig: Labrig, is_sound: Sound
) -> None:
    """A killed sweep or insertion is completed, others stay as they are; a finished run is only measured again."""
    done = labrig("resume", killed, "--json")
    if made.name in {"steerability", "insertion"}:
        assert (done.exit_code, done.json()["exit_status"]) == (0, "success")
        is_sound(killed, "success")
    else:
        assert (done.exit_code, "nothing of it can be kept" in done.json()["error"]["message"]) == (2, True)
        assert labrig("runs", "check", killed).exit_code == 0
    if made.name == "design":
        return
    results = len(list(run.glob("analysis/*")))
    done = labrig("resume", run, "--json")
    assert (done.exit_code, done.json()["exit_status"]) == (0, "success")
    assert len(list(run.glob("analysis/*"))) == results + 1
    is_sound(run, "success")


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


def test_what_a_run_found_is_adopted_or_refused(
    made: Made, run: Path, tmp_path: Path, labrig: Labrig
) -> None:
    """A calibration goes to the rig's files; it replaces one with --force alone; other runs have none."""
    rig = tmp_path / "rig.yaml"
    rig.write_text(RIG.read_text(encoding="utf-8"), encoding="utf-8")
    adopted = labrig("calibrate", "adopt", run, "--rig", rig)
    if made.name != "calibration":
        assert (adopted.exit_code, "holds no calibration" in adopted.err) == (4, True)
        return
    assert (adopted.exit_code, (tmp_path / "simulated-plane.json").exists()) == (0, True)
    again = labrig("calibrate", "adopt", run, "--rig", rig)
    assert (again.exit_code, "replace the old one with --force" in again.err) == (2, True)
    forced = labrig("calibrate", "adopt", run, "--rig", rig, "--force")
    assert (forced.exit_code, "mm wide" in forced.out) == (0, True)
