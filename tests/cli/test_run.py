"""`labrig run` to the report, and `labrig resume`: specimens, cameras, a live view, full disks, early ends."""

import json
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from datetime import timedelta
from hashlib import sha256
from http import HTTPStatus
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import cv2
import numpy as np
import pytest

from labrig.cli.live import Follower
from labrig.cli.options import complete_live
from labrig.devices.clocks import SystemClock
from labrig.errors import DiskError
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.protocol.load import load_protocol
from labrig.protocol.yaml_file import dump_yaml
from labrig.record.check import check_run
from labrig.record.events import RunStop
from labrig.record.lock import FileLock
from labrig.record.reader import open_run
from labrig.record.writer import Recorder, opening_files
from tests.analysis.synthetic import SyntheticSweep, record_sweep
from tests.cli.conftest import RIG, ROOT, SMALL_RIG, SMALL_SWEEP, SWEEP, Labrig, SweepRun, sweep_command
from tests.cli.cut_runs import cut_short
from tests.cli.example_runs import of_protocol
from tests.cli.test_refusals import contents
from tests.disks import full_disk
from tests.protocol.specimens import CAST_ON, sweep_in, write_specimen
from tests.record.runs import ENDED, PROTOCOL_YAML, STARTED, killed_run, picture


def test_a_sweep_succeeds_and_states_a_radius_for_each_gel(sweep: SweepRun) -> None:
    """The JSON document names the run, its report, its checksum and each gel's mean radius, SD, n and interval."""
    assert sweep.document["exit_status"] == "success"
    assert Path(sweep.document["report"]).is_file()
    assert sweep.document["checksum"] == sha256((sweep.run / "SHA256SUMS").read_bytes()).hexdigest()
    specimens = sweep.document["result"]["specimens"]
    assert [specimen["n"] for specimen in specimens] == [2, 2]
    for specimen in specimens:
        low, high = specimen["ci95_mm"]
        assert low < specimen["mean_radius_mm"] < high


ONE = ("--set", "insertions_per_specimen=1", "--set", "specimens=[{name: gel-10, gelatin_percent: 10}]")


def test_the_same_seed_gives_the_same_bytes_and_another_one_other_radii(
    labrig: Labrig, tmp_path: Path
) -> None:
    """The record of a seed is the same, byte for byte, and replays to the last bit; --seed is recorded."""
    runs = [tmp_path / name for name in ("one", "again", "other")]
    for run in runs:
        words = ("--runs-dir", tmp_path, "--run-name", run.name, *SMALL_SWEEP, *ONE)
        assert labrig("run", SWEEP, *words, "--seed", 7 if run.name == "other" else 42).exit_code == 0
    one, again, _ = runs
    assert labrig("replay", again, "--json").json()["verdict"] == "identical"
    frames = [f"frames/{path.name}" for path in (one / "frames").iterdir()]
    for name in ("states.jsonl", "events.jsonl", "frames.jsonl", "truth.jsonl", "can.log", *frames):
        assert (again / name).read_bytes() == (one / name).read_bytes(), name
    seeds = [open_run(run).manifest["seed"] for run in runs]
    radii_mm = [open_run(run).truth["radius_mm"][0] for run in runs]
    assert (seeds, radii_mm[0] == radii_mm[1] != radii_mm[2]) == ([42, 42, 7], True)


def test_a_signal_stops_the_run_and_closes_its_record(tmp_path: Path) -> None:
    """Also one that a background run is told to ignore: axes stop, the record is closed as aborted, exit code 130."""
    command = [*sweep_command(RIG, tmp_path), *map(str, SMALL_SWEEP), "--set", "insertions_per_specimen=18"]
    ignoring = ["sh", "-c", 'trap "" INT HUP; exec "$@"', "sh", *command]
    with subprocess.Popen(ignoring, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as started:
        assert started.stderr is not None
        assert "%" in started.stderr.readline()
        started.send_signal(signal.SIGHUP)
        _, err = started.communicate(timeout=300)
    assert (started.returncode, "Traceback" in err) == (130, False)
    (run,) = tmp_path.iterdir()
    manifest = json.loads((run / "manifest.json").read_text())
    assert (manifest["exit_status"], "HUP" in manifest["reason"]) == ("aborted", True)
    assert list(open_run(run).events["kind"])[-1] == "run_stop"


def test_a_rig_has_a_mask_that_every_run_keeps_and_uses(labrig: Labrig, tmp_path: Path) -> None:
    """A mask of the rig file is recorded, and applied to every picture."""
    folder = Path(shutil.copytree(RIG.parent, tmp_path / "calibration"))
    cv2.imwrite(str(folder / "clamp.png"), np.full((224, 352), 255, np.uint8))
    at = (
        "--rig", folder / RIG.name, "--set", "rig.calibration.mask=clamp.png", "--runs-dir",
        tmp_path / "runs",
    )  # fmt: skip
    run = Path(labrig("run", SWEEP, *SMALL_SWEEP, *ONE, *at, "--json").json()["run"])
    assert (run / "calibration" / "mask.png").read_bytes() == (folder / "clamp.png").read_bytes()
    result = json.loads((run / "analysis" / "001" / "result.json").read_text())
    assert not any(measurement["accepted"] for measurement in result["measurements"]), "everything is masked"
    assert "calibration/mask.png" in result["inputs"]
    assert labrig("replay", run, "--json").json()["identical"]


RECORD = ROOT / "tests" / "records" / "steerability"
FILES = "camera: {{driver: files, source: pictures, width_px: {}, height_px: {}, rate_hz: 30}}\n"
CALIBRATION = "calibration: {intrinsics: calibration/intrinsics.json, plane: calibration/plane.json}\n"


def _rig(folder: Path) -> Path:
    """Write the rig of a kept record, with the pictures of that record in place of its camera."""
    for place, name in (("frames", "pictures"), ("calibration", "calibration")):
        shutil.copytree(RECORD / place, folder / name)
    before, rest = (RECORD / "rig.yaml").read_text(encoding="utf-8").split("camera:\n", 1)
    after = rest.split("recording:\n", 1)[1]
    path = folder / "rig.yaml"
    path.write_text(f"{before}{FILES.format(352, 224)}{CALIBRATION}recording:\n{after}", encoding="utf-8")
    return path


@pytest.mark.processors
def test_a_sweep_runs_whole_on_the_pictures_of_another(labrig: Labrig, tmp_path: Path) -> None:
    """Its radii are theirs to 1 % of sigma; the page says `recorded pictures`, no truth is recorded; it replays."""
    rig = _rig(tmp_path)
    checked = labrig("devices", "check", "--rig", rig)
    assert "352x224 px, recorded pictures of pictures: they never steer" in checked.out
    done = labrig("run", RECORD / "protocol.yaml", "--rig", rig, "--runs-dir", tmp_path / "runs", "--json")
    assert done.exit_code == 0, done.err
    run = Path(done.json()["run"])
    before, after = (
        json.loads((path / "analysis" / "001" / "result.json").read_text()) for path in (RECORD, run)
    )
    sigma_mm = before["measurements"][-1]["sigma_radius_mm"]
    assert after["mean_radius_mm"] == pytest.approx(before["mean_radius_mm"], abs=0.01 * sigma_mm)
    assert list(open_run(run).frame_table["sha256"]) == list(open_run(RECORD).frame_table["sha256"])
    camera = open_run(run).devices["camera"]
    assert (camera["driver"], camera["device"], camera["recorded_pictures"]) == ("files", "pictures", True)
    assert "recorded pictures</span>" in (run / "report.html").read_text(encoding="utf-8")
    assert after.get("truth") is None
    assert labrig("runs", "check", run).exit_code == 0
    assert labrig("replay", run, "--json").json()["verdict"] == "identical"


def test_real_drives_are_not_steered_by_recorded_pictures(labrig: Labrig, tmp_path: Path) -> None:
    """An insertion and a roll zero are refused before anything is opened; a sweep with fixed moves is accepted."""
    before, rest = (RIG.parent / "rig-bench.yaml").read_text(encoding="utf-8").split("camera:\n", 1)
    rig = tmp_path / "rig.yaml"
    rig.write_text(f"{before}{FILES.format(64, 48)}\n{rest.partition(chr(10) * 2)[2]}", encoding="utf-8")
    words = "moves real drives by what its pictures show, and camera.driver files gives recorded pictures"
    for name in ("insertion", "roll-zero", "steerability"):
        protocol = (ROOT / "protocols" / f"{name}.yaml", "--rig", rig)
        told = labrig("check", *protocol, "--json").out
        assert (f"{name} {words}" in told) is (name != "steerability")
        assert labrig("run", *protocol).exit_code == 2


def test_a_run_shown_live_is_the_same_run(
    labrig: Labrig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its record is whole and replays to the last bit, as that of a run that nobody watched; view.rrd is kept."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    done = labrig("run", *of_protocol("steerability"), "--runs-dir", tmp_path, "--run-name", "run", "--live")
    assert (done.exit_code, "there is no display here" in done.err) == (0, True), done.err
    assert (tmp_path / "run" / "view.rrd").stat().st_size > 10_000
    assert check_run(tmp_path / "run").damage == ()
    assert labrig("replay", tmp_path / "run", "--json").json()["identical"] is True


def test_a_viewer_that_does_not_start_is_told_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It leaves the record as it is."""
    viewer = tmp_path / "rerun"
    viewer.write_text("#!/bin/sh\nexit 1\n")
    viewer.chmod(0o755)
    run = record_sweep(tmp_path, SyntheticSweep(radii_mm={"gel": (28.0,)}, gelatin_percent=(13,)))
    follower = Follower("viewer", str(viewer))
    follower.follow(run.path)
    follower.finish(120.0)
    assert capsys.readouterr().err.count("live view: nothing") == 1
    assert check_run(run.path).damage == ()


@pytest.mark.slow
def test_a_browser_is_told_before_the_run_and_stays_after_it(tmp_path: Path) -> None:
    """Until Ctrl+C the page is served; then the run's exit code is returned."""
    words = ("run", *of_protocol("steerability"), "--live", "web", "--runs-dir", tmp_path)
    command, none = [sys.executable, "-m", "labrig", *map(str, words)], subprocess.DEVNULL
    with subprocess.Popen(command, stdin=none, stdout=none, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        said = []
        for line in process.stderr:
            said.append(line)
            if "stays open" in line:
                break
        opened, *_ = (number for number, line in enumerate(said) if "live view: open http" in line)
        assert not any("elapsed" in line for line in said[:opened])
        page = re.search(r"http://\S+", said[opened])
        assert page is not None
        with urlopen(page[0]) as reply:
            assert reply.status == HTTPStatus.OK
        process.send_signal(signal.SIGINT)
        assert process.wait(300) == 0


def test_live_alone_is_the_viewer() -> None:
    """The parser knows no option whose value may be left out."""
    assert complete_live(["run", "--live", "p.yaml"]) == ["run", "--live", "viewer", "p.yaml"]
    assert complete_live(["run", "--live"]) == ["run", "--live", "viewer"]
    assert complete_live(["run", "--live", "web", "--yes"]) == ["run", "--live", "web", "--yes"]


SHORT = (
    *SMALL_RIG, "--set", "insertions_per_specimen=1", "--set", "insertion.length_mm=22",
    "--set", "insertion.speed_mm_s=5", "--set", "insertion.frame_every_mm=20",
)  # fmt: skip


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a working folder of its own."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def list_places_mm(run: Path) -> Sequence[float]:
    """Return the entry points of a run [mm]."""
    return list(open_run(run).trials["hole_position_mm"])


def test_a_second_run_keeps_off_the_tracks_of_the_first(bench: Path, labrig: Labrig) -> None:
    """The hole of the first is refused, the proposed one is clear, both are listed, and a resumed run keeps off too."""
    write_specimen(bench, lines="batch: <b>7</b>\n")
    protocol = sweep_in(bench, "specimen_file: A1")
    assert labrig("run", protocol, *SHORT, "--run-name", "one", "--json").exit_code == 0
    checked = labrig("check", protocol, *SHORT, "--json")
    (problem,) = checked.json()["problems"]
    assert (checked.exit_code, problem["where"]) == (1, "specimens.0.first_hole_mm")
    assert "would be 0.00 mm from that of hole 1 of run one, at 0 mm" in problem["message"]
    refused = labrig("run", protocol, *SHORT, "--run-name", "none")
    assert (refused.exit_code, (bench / "data/runs/none").exists()) == (2, False)
    place_mm = float(problem["hint"].split("first_hole_mm: ")[1].split(" ")[0])
    place = ("--set", f"specimens.0.first_hole_mm={place_mm}")
    assert labrig("run", protocol, *SHORT, *place, "--run-name", "two").exit_code == 0
    run = bench / "data" / "runs" / "two"
    assert list_places_mm(run) == [place_mm]
    shown = labrig("specimens", "A1", "--json").json()
    assert [track["hole_position_mm"] for track in shown["tracks"]["simulated"]] == [0.0, place_mm]
    assert shown["tracks"]["real"] == []
    assert "\ntracks of simulated runs:\n" in labrig("specimens", "A1").out
    assert labrig("replay", run, "--json").json()["identical"] is True
    cut = cut_short(run, run.with_name("cut"), float(open_run(run).trials["start_t_s"][0]) + 8.0)
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


def test_the_axes_stop_and_the_record_says_why(labrig: Labrig, tmp_path: Path) -> None:
    """Exit code 3, a readable run closed as failed with the reason, and every acknowledged picture in it."""
    long = ("--set", "insertions_per_specimen=18", "--set", "rig.recording.state_rate_hz=50")
    with full_disk(1_060_000):
        done = labrig(
            "run", SWEEP, "--runs-dir", tmp_path, "--run-name", "run", "--json", *SMALL_SWEEP, *long
        )
    assert (done.exit_code, done.json()["exit_status"]) == (3, "failed")
    run = open_run(tmp_path / "run")
    assert (run.manifest["exit_status"], "File too large" in str(run.manifest["reason"])) == ("failed", True)
    assert (run.damage, check_run(tmp_path / "run").damage) == ((), ())
    assert list(run.events["kind"])[-1] == "run_stop"
    assert len(list(run.pictures)) == len(run.frame_table) > 5


@pytest.mark.parametrize(
    "line",
    [
        "runs annotate open --tag pilot", "runs annotate closed --note cloudy", "reanalyze closed",
        "report closed", "export closed --format csv --out tables",
    ],
)  # fmt: skip
def test_a_command_on_a_full_disk_says_so_and_changes_nothing(
    line: str, labrig: Labrig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exit code 3 with the file; no run is touched."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "tests" / "records" / "steerability", "closed")
    killed_run(tmp_path, "open")
    before = contents(tmp_path)
    with full_disk():
        done = labrig(*line.split())
    assert (done.exit_code, "Traceback" in done.err, "File too large" in done.err) == (3, False, True)
    assert contents(tmp_path) == before


def test_a_run_ends_before_other_programs_cannot_write(tmp_path: Path) -> None:
    """Where the disk has less free than a run is to leave, its next picture is refused with both numbers."""
    manifest = {"experiment": "import", "started": STARTED.isoformat()}
    for name, least_bytes in (("enough", 1), ("full", 10**18)):
        recorder = Recorder.create(
            tmp_path, name, manifest, opening_files(PROTOCOL_YAML), least_free_bytes=least_bytes
        )
        below = pytest.raises(DiskError, match=r"has \d+\.\d MB free; a run ends below 1000000000000\.0 MB")
        with below if name == "full" else nullcontext():
            recorder.frame(picture(0), 2.0, role="advance")
        recorder.close("failed", "", ENDED)


FAULTS = ("silent", "emergency, code: 0x8611", "unplugged")


def require_order(err: str, axis: str, *, is_lost: bool) -> None:
    """Require lost drives to be told before anything else, then motion, place, error and remedy, each as a line."""
    motion = "not every axis is known to stand still" if is_lost else "every axis stands still"
    words = (f"needle: {motion}", f"positions: {axis} ", "error: ", "hint: ")
    places = [
        f"\n{err}".find(f"\n{word}") for word in words
    ]  # no line of progress is before it in a quick run
    assert (places, places[0] >= 0) == (sorted(places), True), err
    told = err.find(
        "press the emergency stop; what the needle" if axis == "insertion" else "press the emergency stop"
    )
    assert (0 <= told < places[0]) is is_lost or not is_lost, err


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_motion_place_remedy_and_record_are_said_in_this_order(
    fault: str, labrig: Labrig, tmp_path: Path
) -> None:
    """A person reads first what the needle is doing; then the record, which has the place of each axis."""
    axis = "null" if fault == "unplugged" else "insertion"
    script = ("--set", f"rig.faults=[{{fault: {fault}, axis: {axis}, at_s: 12}}]")
    slow = ("--set", "insertion.speed_mm_s=1", "--set", "rig.world.bubbles_per_specimen=0")
    done = labrig("run", SWEEP, "--runs-dir", tmp_path, "--json", *SMALL_SWEEP, *ONE, *slow, *script)
    document, is_lost = done.json(), not fault.startswith("emergency")
    assert done.exit_code == 3, done.err
    require_order(done.err, "insertion", is_lost=is_lost)
    assert done.err.find("then: ") < done.err.find(f"the record is kept: {document['run']}")
    needle = document["needle"]
    assert (needle["motion"], needle["in_tissue"]) == ("unknown" if is_lost else "standing still", True)
    assert [axis["axis"] for axis in needle["axes"]] == ["insertion", "rotation", "linear"]
    assert 1 < needle["axes"][0]["position"] < 22
    assert (needle["axes"][0]["age_s"] > 0) is is_lost
    page = Path(document["report"]).read_text(encoding="utf-8")
    assert ('class="pill failed"' in page, "The run failed: " in page) == (True, True)


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS[:2])
@pytest.mark.parametrize(
    ("command", "when"),
    [("jog --axis linear --distance 5", "moving"), ("home --axis linear --method -4", "homing")],
)
def test_home_and_jog_say_where_the_needle_is(
    fault: str, command: str, when: str, labrig: Labrig, tmp_path: Path
) -> None:
    """They tell at once of lost drives, and then motion, place and error as a run does."""
    rig = Path(shutil.copytree(RIG.parent, tmp_path / "rigs")) / "rig.yaml"
    script = f"faults: [{{fault: {fault}, axis: linear, at_s: 0, once: {when}}}]\n"
    rig.write_text(f"{RIG.read_text(encoding='utf-8')}\n{script}", encoding="utf-8")
    done = labrig("devices", *command.split(), "--rig", rig)
    assert (done.exit_code, done.out) == (3, "")
    require_order(done.err, "linear", is_lost=fault == "silent")


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
    assert labrig("reanalyze", run).exit_code == 0
    unended = json.loads((run / "analysis/001/result.json").read_bytes())
    assert {row["trial"] for row in unended["measurements"]} == {0}
    done = labrig("resume", run, "--json")
    assert (done.exit_code, done.json()["exit_status"]) == (0, "success")
    trials = open_run(run).trials.set_index("trial")
    assert list(trials["exit_status"]) == ["success", "interrupted", "success", "success", "success"]
    assert list(trials.index) == [0, 1, 4, 2, 3]
    assert [trials[name][4] for name in ("repeats", "hole", "hole_position_mm")] == [1, 2, 20.0]
    before, after = radii(sweep.document), radii(done.json())
    assert {trial: after[trial] for trial in (0, 2, 3)} == {trial: before[trial] for trial in (0, 2, 3)}
    ours, theirs = open_run(run).frame_table, open_run(sweep.run).frame_table
    for trial in (2, 3):  # in the block that had not been touched, down to the pictures
        first, second = (list(frames[frames["trial"] == trial]["sha256"]) for frames in (ours, theirs))
        assert first == second
    assert [row["n"] for row in done.json()["result"]["specimens"]] == [2, 2]
    assert {row["trial"] for row in done.json()["result"]["measurements"]} == {0, 2, 3, 4}
    assert {name: (run / "frames" / name).read_bytes() for name in kept} == kept
    assert check_run(run).damage == ()
    page = (run / "report.html").read_text(encoding="utf-8")
    assert re.search("trial 2 was interrupted and repeated as trial 5.*Resumed with, session 2", page, re.S)
    assert open_run(run).sessions[0]["provenance"]["python"]
    (row,) = labrig("runs", "--runs-dir", tmp_path, "--json").json()
    assert (row["trials_done"], row["trials_planned"], row["exit_status"]) == (4, 4, "success")


@pytest.mark.parametrize(("name", "before"), [("steerability", ["interrupted"]), ("insertion", [])])
def test_a_failed_run_goes_on(name: str, before: list[str], labrig: Labrig, tmp_path: Path) -> None:
    """A run that failed on a restarted drive, in a trial or before, prints what resumes it; resumed, it ends well."""
    fault = ("--set", "rig.faults=[{fault: boot-up, axis: linear, at_s: 6, once: moving}]")
    failed = labrig("run", *of_protocol(name), "--runs-dir", tmp_path, "--run-name", "a run", *fault)
    assert failed.exit_code == 3
    assert "nothing is to be taken out" in failed.err
    assert f"continue it: labrig resume '{tmp_path}/a run'" in failed.err
    done = labrig("resume", tmp_path / "a run", "--json")
    assert (done.exit_code, done.json()["exit_status"]) == (0, "success")
    run = open_run(tmp_path / "a run")
    assert list(run.trials["exit_status"]) == [*before, "success"]
    assert [stop.exit_status for stop in run.read_events(RunStop)] == ["failed", "success"]


def test_a_run_that_had_only_to_be_closed_is_closed(sweep: SweepRun, labrig: Labrig, tmp_path: Path) -> None:
    """A run killed after its last insertion needs no rig: it is closed, measured and reported."""
    run = cut_short(sweep.run, tmp_path / "run", 1e9)
    done = labrig("resume", run, "--json")
    assert done.exit_code == 0
    assert radii(done.json()) == radii(sweep.document)
    assert check_run(run).exit_status == "success"


@pytest.mark.parametrize(
    ("file", "old", "new", "words"),
    [
        (RIG.name, "noise_sd: 3", "noise_sd: 5", "world.noise_sd: the run began with 3.0, now it is 5"),
        ("simulated-tip.json", "{", " {", "calibration template.json: the run began with SHA-256 "),
    ],
)
def test_what_has_changed_is_refused_with_the_difference(
    cut: Path, labrig: Labrig, tmp_path: Path, file: str, old: str, new: str, words: str
) -> None:
    """Another rig or calibration exits with 2, names each value, and leaves the record unchanged."""
    folder = Path(shutil.copytree(RIG.parent, tmp_path / "changed"))
    (folder / file).write_text((folder / file).read_text(encoding="utf-8").replace(old, new, 1))
    before = contents(cut)
    done = labrig("resume", cut, "--rig", folder / RIG.name)
    assert (done.exit_code, words in done.err) == (2, True)
    assert contents(cut) == before


def test_a_run_that_is_being_written_is_not_continued(cut: Path, labrig: Labrig) -> None:
    """Resuming a run that another process is writing exits with 3 and names the process; an export says so."""
    with FileLock(cut / ".lock").acquire("labrig run"):
        done, exported = labrig("resume", cut, "--json"), labrig("export", cut, "--out", cut.parent / "out")
    assert (done.exit_code, done.json()["error"]["type"]) == (3, "LockedError")
    assert "note: labrig run (process" in exported.err


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


def test_a_target_without_a_path_is_told_before_anything_moves(labrig: Labrig, tmp_path: Path) -> None:
    """Who sees it can say no at the first question, before holes are made for the roll zero."""
    away = ("--set", "target.position_mm=[0,-9,7]", "--runs-dir", tmp_path)
    said = labrig("run", *of_protocol("insertion"), *away).err.splitlines()
    assert said[0].startswith("in a rehearsal 1 of 1 insertion failed; no path: the needle cannot be steered")
