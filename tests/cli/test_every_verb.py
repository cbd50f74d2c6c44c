"""The kept record of each experiment through every command that takes a run.

The records are those that `python -m tests.records` makes, kept under tests/records.
"""

import json
import re
import shlex
import shutil
from pathlib import Path
from typing import Any

import pytest

from labrig.record.json_lines import encode_line, read_lines
from tests.cli.conftest import RIG, ROOT, SWEEP, Labrig
from tests.cli.cut_runs import cut_short, open_again
from tests.cli.example_runs import SHORTENED, of_protocol

KEPT, INSERTION = ROOT / "tests" / "records", ROOT / "protocols" / "insertion.yaml"
NAMES = sorted(path.name for path in KEPT.iterdir() if path.is_dir())
MEASURED = [pytest.param(name, marks=[pytest.mark.slow] * (name == "design")) for name in NAMES]
"""A design takes long to compute."""
AGREES = ("identical", "equivalent")
TABLES = "csv/states.csv OUT/csv/events.csv OUT/csv/frames.parquet OUT/csv/run.mat OUT/csv/manifest.json"
VERBS = {
    "report RUN": ("RUN/report.html", "report.html"),
    "view RUN --json": ("RUN/view.rrd", "view.rrd"),
    "export RUN --format csv --format parquet --format matlab --out OUT/csv": (f"OUT/{TABLES}", "run.mat"),
    "export RUN --format csv --out OUT/csv --force": (f"OUT/{TABLES}", "states.csv"),
    "export RUN --format record --out OUT/copy": ("OUT/copy/manifest.json", "OUT/copy"),
    "export RUN --format record --out OUT/copy --force": ("OUT/copy/manifest.json", "OUT/copy"),
    "runs check RUN OUT/copy": ("RUN/manifest.json", "OUT/copy"),
    "runs annotate RUN --tag kept --note 'look again' --verdict good --by Ada": ("RUN/notes.json", ""),
    "runs show RUN": ("RUN/notes.json", "Ada: look again"),
    "runs --runs-dir RUN/.. --where tag=kept": ("RUN/notes.json", "kept"),
}
"""What succeeds with any run, the files that are there then, and what is printed."""


@pytest.fixture(params=NAMES)
def kept(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Return a writable copy of a kept record."""
    run = Path(shutil.copytree(KEPT / request.param, tmp_path / "runs" / request.param))
    (run / "frames").mkdir(exist_ok=True)  # an empty folder is not in a checkout
    return run


@pytest.fixture
def killed(kept: Path, tmp_path: Path) -> Path:
    """Return the same run as a power cut in the middle of it leaves it."""
    lines = "frames.jsonl" if kept.name == "import" else "events.jsonl"
    times_s = [float(t_s) for t_s in re.findall(r'"t_s":\s*([-+.e\d]+)', (kept / lines).read_text())]
    return cut_short(kept, tmp_path / "killed" / kept.name, (times_s[0] + times_s[-1]) / 2)


def require_sound(labrig: Labrig, run: Path, exit_status: str = "success") -> None:
    """Require that a run is called sound, closed with a status, and nothing of it torn."""
    done = labrig("runs", "check", run, "--json")
    (row,) = done.json()
    verdict = (row["ok"], row["damage"], row["notices"], row["exit_status"])
    assert (done.exit_code, *verdict) == (0, True, [], [], exit_status)


def use_every_verb(run: Path, out: Path, labrig: Labrig) -> None:
    """Have each verb use a run; look for its files, and for what it prints."""
    for words, (files, told) in VERBS.items():
        line, paths, part = (
            text.replace("RUN", str(run)).replace("OUT", str(out)) for text in (words, files, told)
        )
        done = labrig(*shlex.split(line))
        assert (done.exit_code, part in done.out) == (0, True), (words, done)
        assert all(Path(path).stat().st_size > 0 for path in paths.split()), words


def make_rig(run: Path, lab: Path) -> Path:
    """Return the rig file that a kept record names, in a folder with the calibration that the record began with."""
    shutil.copytree(RIG.parent, lab / "calibration")
    found = lab / "tests" / "records" / "camera-calibration" / "analysis" / "001"
    found.mkdir(parents=True)
    for name in ("intrinsics.json", "plane.json"):
        shutil.copy(run / "calibration" / name, found)
    return lab / "calibration" / RIG.name


def test_one_small_record_of_each_experiment_is_kept() -> None:
    """And each example protocol is shortened here: a new one must pass every command too."""
    manifests = [json.loads((KEPT / name / "manifest.json").read_text(encoding="utf-8")) for name in NAMES]
    assert {manifest["experiment"] for manifest in manifests} >= {
        "steerability", "insertion", "roll-zero", "camera-calibration", "design", "import",
    }  # fmt: skip
    assert sum(path.stat().st_size for path in KEPT.rglob("*") if path.is_file()) < 2_200_000
    protocols = {path.stem for path in (ROOT / "protocols").glob("*.yaml")}
    assert set(SHORTENED) == {name for name in protocols if not name.startswith("campaign-")}


@pytest.mark.parametrize("name", SHORTENED)
def test_check_finds_no_problem(name: str, labrig: Labrig) -> None:
    """The dry run of each example has no problems, and tells duration, disk space, calibration and what it left out."""
    done = labrig("check", *of_protocol(name), "--json")
    document = done.json()
    assert (done.exit_code, document["ok"], document["problems"]) == (0, True, [])
    if name == "steerability":
        whole = labrig("check", SWEEP, "--rig", RIG, "--json").json()
        assert whole["duration_s"] > 72 * 40
        assert 0.5 < whole["disk_bytes"] / (72 * 10 * 1280 * 720) < 1.0  # ten pictures a trial
        assert [age["check"] for age in document["calibration"]] == [
            "calibration intrinsics age", "calibration plane age",
        ]  # fmt: skip
        assert "drives and camera (labrig devices check)" in document["left_to_run"]


def test_every_verb_takes_a_finished_run(kept: Path, tmp_path: Path, labrig: Labrig) -> None:
    """Run and copy stay sound; what was said of the run is found."""
    use_every_verb(kept, tmp_path / "out", labrig)
    (row,) = labrig("runs", "--runs-dir", kept.parent, "--where", "tag=kept", "--json").json()
    assert (Path(row["run"]), row["tags"], row["notes"], row["verdict"]) == (kept, ["kept"], 1, "good")
    require_sound(labrig, kept)
    require_sound(labrig, tmp_path / "out" / "copy")


@pytest.mark.parametrize("kept", ["import"], indirect=True)
def test_pictures_that_nobody_has_measured_have_a_page(
    kept: Path, labrig: Labrig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It says how to measure them. Without a display their view is made, and it is said how to open it."""
    shutil.rmtree(kept / "analysis")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert "there is no display here" in labrig("view", kept).err
    assert labrig("report", kept).exit_code == 0
    assert "<code>labrig reanalyze" in (kept / "report.html").read_text(encoding="utf-8")


@pytest.mark.processors
@pytest.mark.parametrize("kept", MEASURED, indirect=True)
def test_a_kept_record_is_measured_as_before(kept: Path, labrig: Labrig) -> None:
    """A reanalysis gives every number of the kept result, on any processor within its tolerance."""
    done = labrig("reanalyze", kept, "--json")
    (row,) = done.json()
    assert (done.exit_code, row["ok"], Path(row["analysis"]).name) == (0, True, "002")
    assert row["verdict"] in AGREES, row["first_difference"]


@pytest.mark.processors
def test_a_kept_record_replays(kept: Path, labrig: Labrig) -> None:
    """The procedure decides the same again; no procedure made imported pictures, and the command says so."""
    done = labrig("replay", kept, "--json")
    replay = done.json()
    if kept.name == "import":
        assert (done.exit_code, replay["error"]["hint"]) == (2, "there is nothing to replay")
    else:
        assert (done.exit_code, replay["first_difference"]) == (0, None)
        assert replay["verdict"] in AGREES


@pytest.mark.processors
@pytest.mark.parametrize(
    "kept", ["insertion", "roll-zero", "steerability", "camera-calibration"], indirect=True
)
def test_a_decision_that_was_altered_by_hand_is_different(kept: Path, labrig: Labrig) -> None:
    """Whatever the processor: one word of one question is not what the procedure says."""
    lines: list[dict[str, Any]] = list(read_lines(kept / "events.jsonl"))
    line = next(line for line in lines if line["kind"] == "operator" and line["details"])
    key = next(iter(line["details"]))
    line["details"] = line["details"] | {key: f"{line['details'][key]} other"}
    (kept / "events.jsonl").write_bytes(b"".join(map(encode_line, lines)))
    open_again(kept)
    done = labrig("replay", kept, "--json")
    replay = done.json()
    assert (done.exit_code, replay["verdict"]) == (1, "different")
    assert replay["first_difference"]["path"] == f"operator.details.{key}"


def test_every_verb_takes_a_killed_run(killed: Path, tmp_path: Path, labrig: Labrig) -> None:
    """It can be checked, replayed, measured, shown, exported and annotated."""
    if killed.name != "design":  # takes long to compute
        assert labrig("replay", killed).exit_code == (2 if killed.name == "import" else 0)
        assert (
            labrig("reanalyze", killed).exit_code == 0
        )  # a roll zero by too few rolls is a result that says no
    use_every_verb(killed, tmp_path / "out", labrig)


@pytest.mark.parametrize("kept", sorted({*NAMES} - {"design"}), indirect=True)
def test_a_run_goes_on_or_says_why_not(kept: Path, killed: Path, tmp_path: Path, labrig: Labrig) -> None:
    """A killed sweep or insertion is completed, others stay as they are; a finished run is only measured again."""
    goes_on = kept.name in {"steerability", "insertion"}
    done = labrig("resume", killed, *("--rig", make_rig(kept, tmp_path / "lab")) if goes_on else (), "--json")
    if goes_on:
        assert (done.exit_code, done.json()["exit_status"]) == (0, "success")
        require_sound(labrig, killed)
    else:
        assert (done.exit_code, "nothing of it can be kept" in done.json()["error"]["message"]) == (2, True)
        assert labrig("runs", "check", killed).exit_code == 0
    done = labrig("resume", kept, "--json")
    assert (done.exit_code, done.json()["exit_status"]) == (0, "success")
    assert len(list(kept.glob("analysis/*"))) == 2
    require_sound(labrig, kept)


@pytest.mark.parametrize("kept", ["camera-calibration", "roll-zero"], indirect=True)
def test_what_a_run_found_is_adopted_or_refused(kept: Path, tmp_path: Path, labrig: Labrig) -> None:
    """A calibration goes to the rig's files; it replaces one with --force alone; other runs have none."""
    adopt = ("calibrate", "adopt", kept, "--rig", shutil.copy(RIG, tmp_path / "rig.yaml"))
    adopted = labrig(*adopt)
    if kept.name != "camera-calibration":
        assert (adopted.exit_code, "holds no calibration" in adopted.err) == (4, True)
        return
    assert (adopted.exit_code, (tmp_path / "simulated-plane.json").exists()) == (0, True)
    again, forced = labrig(*adopt), labrig(*adopt, "--force")
    assert (again.exit_code, "replace the old one with --force" in again.err) == (2, True)
    assert (forced.exit_code, "mm wide" in forced.out) == (0, True)
    bench = shutil.copy(RIG.with_name("rig-bench.yaml"), tmp_path / "bench.yaml")
    refused = labrig(*adopt[:-1], bench, "--force")
    assert (refused.exit_code, "calibrated a simulated camera" in refused.err) == (2, True)


def test_a_run_whose_insertion_failed_stays_failed_when_it_is_resumed(tmp_path: Path, labrig: Labrig) -> None:
    """Nothing of it is left to be made: it is measured again, and its record is as it was."""
    run, made = tmp_path / "near", ("--runs-dir", tmp_path, "--run-name", "near", "--rig", RIG, "--yes")
    failed = labrig("run", INSERTION, *made, "--set", "target.position_mm=[0,20,10]")
    before = (run / "SHA256SUMS").read_bytes()
    again = labrig("resume", run)
    assert (failed.exit_code, again.exit_code, (run / "SHA256SUMS").read_bytes()) == (1, 1, before)


def test_a_check_whose_rehearsal_ends_early_says_so(labrig: Labrig) -> None:
    """The needle of the rig bends otherwise than the protocol says."""
    checked = labrig("check", INSERTION, "--rig", RIG, "--set", "planner.radius_mm=15")
    assert "warning: protocol: rehearsed, it ends early: no roll zero: over" in checked.out + checked.err
