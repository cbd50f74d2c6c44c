"""`labrig resume`."""

import shutil
from pathlib import Path
from typing import Any

import pytest

from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.protocol.load import load_protocol
from labrig.protocol.yaml_file import dump_yaml
from labrig.record.check import check_run
from labrig.record.events import RunStop
from labrig.record.lock import FileLock
from labrig.record.reader import open_run
from labrig.record.writer import Recorder, opening_files
from tests.cli.conftest import RIG, ROOT, SMALL_RIG, SWEEP, Labrig, SweepRun
from tests.cli.cut_runs import cut_short
from tests.record.runs import ENDED, STARTED


def radii(document: dict[str, Any]) -> dict[int, float]:
    """Return the radius of each trial's final picture."""
    return {
        row["trial"]: row["radius_mm"]
        for row in document["result"]["measurements"]
        if row["role"] == "final" and row["trial"] is not None
    }


@pytest.fixture(scope="module")
def cut(sweep: SweepRun, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a sweep of four insertions, killed in the second while its needle is deep in the gel."""
    pictures = open_run(sweep.run).frame_table
    deep_s = float(pictures[(pictures["trial"] == 1) & (pictures["role"] == "advance")]["t_s"].iloc[-1])
    return cut_short(sweep.run, tmp_path_factory.mktemp("runs") / "cut, é", deep_s + 0.5)


def test_a_sweep_goes_on_and_gives_what_it_would_have_given(
    cut: Path, sweep: SweepRun, labrig: Labrig, tmp_path: Path
) -> None:
    """Finished insertions are kept, the interrupted one is repeated elsewhere, and the others are unchanged."""
    run = cut_short(sweep.run, tmp_path / "run", float(open_run(cut).states["t_s"].iloc[-1]))
    kept = {path.name: path.read_bytes() for path in (run / "frames").iterdir()}
    done = labrig("resume", run, "--json")
    assert done.exit_code == 0
    assert done.json()["exit_status"] == "success"
    trials = open_run(run).trials.set_index("trial")
    assert list(trials["exit_status"]) == ["success", "interrupted", "success", "success", "success"]
    assert list(trials.index) == [0, 1, 4, 2, 3]
    assert [trials[name][4] for name in ("repeats", "hole", "hole_position_mm")] == [1, 2, 20.0]
    before, after = radii(sweep.document), radii(done.json())
    assert {trial: after[trial] for trial in (0, 2, 3)} == {trial: before[trial] for trial in (0, 2, 3)}
    ours, theirs = open_run(run).frame_table, open_run(sweep.run).frame_table
    for trial in (2, 3):  # in the block that had not been touched, down to the pictures
        digests = [list(frames[frames["trial"] == trial]["sha256"]) for frames in (ours, theirs)]
        assert digests[0] == digests[1]
    assert [row["n"] for row in done.json()["result"]["specimens"]] == [2, 2]
    assert {name: (run / "frames" / name).read_bytes() for name in kept} == kept
    assert check_run(run).damage == ()
    page = (run / "report.html").read_text(encoding="utf-8")
    assert "trial 2 was interrupted and repeated as trial 5" in page
    assert "Resumed with, session 2" in page
    assert open_run(run).sessions[0]["provenance"]["python"]
    (row,) = labrig("runs", "--runs-dir", tmp_path, "--json").json()
    assert (row["trials_done"], row["trials_planned"], row["exit_status"]) == (4, 4, "success")


def test_a_run_that_failed_goes_on_without_its_fault(
    labrig: Labrig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run that failed on a restarted drive prints the command that resumes it; resumed, and watched, it ends well."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    one_gel = "specimens=[{name: gel-13, gelatin_percent: 13}]"
    fault = "rig.faults=[{fault: boot-up, axis: linear, at_s: 6, once: moving}]"
    quick = ("--set", "insertion.speed_mm_s=8", "--set", "insertion.length_mm=22")
    words = ["--runs-dir", tmp_path, "--run-name", "a run", "--set", "insertions_per_specimen=1"]
    failed = labrig("run", SWEEP, *SMALL_RIG, *words, *quick, "--set", one_gel, "--set", fault)
    assert failed.exit_code == 3
    assert "nothing is to be taken out" in failed.err
    assert f"continue it: labrig resume '{tmp_path}/a run'" in failed.err
    done = labrig("resume", "--live", tmp_path / "a run", "--json")
    assert (done.exit_code, done.json()["exit_status"]) == (0, "success")
    run = open_run(tmp_path / "a run")
    assert (run.path / "view.rrd").stat().st_size > 10_000
    assert list(run.trials["exit_status"]) == ["interrupted", "success"]
    assert [stop.exit_status for stop in run.read_events(RunStop)] == ["failed", "success"]


def test_a_run_that_had_only_to_be_closed_is_closed(sweep: SweepRun, labrig: Labrig, tmp_path: Path) -> None:
    """A run killed after its last insertion needs no rig: it is closed, measured and reported."""
    run = cut_short(sweep.run, tmp_path / "run", 1e9)
    done = labrig("resume", run, "--json")
    assert done.exit_code == 0
    assert radii(done.json()) == radii(sweep.document)
    assert check_run(run).exit_status == "success"


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("rig", "world.noise_sd: the run began with 3.0, now it is 5"),
        ("calibration", "calibration template.json: the run began with SHA-256 "),
    ],
)
def test_what_has_changed_is_refused_with_the_difference(
    cut: Path, labrig: Labrig, tmp_path: Path, what: str, words: str
) -> None:
    """Another rig or calibration exits with 2, names each value, and leaves the record unchanged."""
    folder = Path(shutil.copytree(RIG.parent, tmp_path / "changed"))
    changed = folder / {"rig": RIG.name, "calibration": "simulated-tip.json"}[what]
    text = changed.read_text(encoding="utf-8")
    changed.write_text(text.replace("noise_sd: 3", "noise_sd: 5") if what == "rig" else f"{text}\n")
    before = {path: path.read_bytes() for path in cut.rglob("*") if path.is_file()}
    done = labrig("resume", cut, "--rig", folder / RIG.name)
    assert (done.exit_code, words in done.err) == (2, True)
    assert {path: path.read_bytes() for path in cut.rglob("*") if path.is_file()} == before


def test_a_run_that_is_being_written_is_not_continued(cut: Path, labrig: Labrig) -> None:
    """Resuming a run that another process is writing exits with 3 and names the process."""
    with FileLock(cut / ".lock").acquire("labrig run"):
        done = labrig("resume", cut, "--json")
    assert done.exit_code == 3
    assert done.json()["error"]["type"] == "LockedError"


def test_a_needle_of_a_run_that_cannot_be_continued_has_a_way_out(labrig: Labrig, tmp_path: Path) -> None:
    """The refusal names the command that withdraws a real needle; a simulated rig has no needle left in its gel."""
    protocol = dump_yaml(load_protocol(ROOT / "protocols" / "roll-zero.yaml", PROTOCOL_MODELS))
    for kind in ("real", "simulated"):
        manifest = {"experiment": "roll-zero", "started": STARTED.isoformat(), "devices": {"kind": kind}}
        recorder = Recorder.create(tmp_path, f"{kind} rig", manifest, opening_files(protocol))
        recorder.event("trial_start", 0.0, trial=0)
        recorder.state(1.0, insertion_mm=5.0, rotation_rad=0.0, linear_mm=1.0)
        done = labrig("resume", recorder.path)
        assert (done.exit_code, "nothing of it can be kept" in done.err) == (2, True)
        way_out = f"labrig devices withdraw --rig FILE --run '{recorder.path}'"
        assert (way_out in done.err) is (kind == "real")
        recorder.close("aborted", "", ENDED)
