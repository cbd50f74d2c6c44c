"""`labrig run` from the protocol to the report: specimens, cameras, a live view, full disks and ends before the end."""

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
from labrig.record.check import check_run
from labrig.record.json_lines import decode_line
from labrig.record.reader import open_run
from labrig.record.writer import Recorder, opening_files
from tests.analysis.synthetic import SyntheticSweep, record_sweep
from tests.cli.conftest import RIG, ROOT, SMALL_RIG, SMALL_SWEEP, SWEEP, Labrig, SweepRun, sweep_command
from tests.cli.cut_runs import cut_short
from tests.cli.example_runs import of_protocol
from tests.disks import full_disk
from tests.protocol.specimens import CAST_ON, sweep_in, write_specimen
from tests.record.runs import ENDED, PROTOCOL_YAML, STARTED, killed_run, picture


def _lines(path: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


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


def test_the_same_seed_gives_the_same_bytes(sweep: SweepRun, labrig: Labrig, tmp_path: Path) -> None:
    """The same protocol, rig and seed give the same record, byte for byte, and it replays to the last bit."""
    again = labrig("run", SWEEP, "--runs-dir", tmp_path, "--json", *SMALL_SWEEP)
    run = Path(again.json()["run"])
    assert labrig("replay", run, "--json").json()["verdict"] == "identical"
    for name in ("states.jsonl", "events.jsonl", "frames.jsonl", "truth.jsonl", "can.log"):
        assert (run / name).read_bytes() == (sweep.run / name).read_bytes(), name
    assert {path.name: path.read_bytes() for path in (run / "frames").iterdir()} == {
        path.name: path.read_bytes() for path in (sweep.run / "frames").iterdir()
    }


def test_another_seed_gives_other_radii(sweep: SweepRun, labrig: Labrig, tmp_path: Path) -> None:
    """--seed changes the draws of the simulated world, and is recorded."""
    short = (*SMALL_SWEEP, "--set", "insertions_per_specimen=1")
    done = labrig("run", SWEEP, "--runs-dir", tmp_path, "--json", "--seed", 7, *short)
    run = Path(done.json()["run"])
    assert _lines(run / "truth.jsonl")[0]["radius_mm"] != _lines(sweep.run / "truth.jsonl")[0]["radius_mm"]
    assert json.loads((run / "manifest.json").read_text())["seed"] == 7


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
    assert _lines(run / "events.jsonl")[-1]["kind"] == "run_stop"


def test_a_rig_has_a_mask_that_every_run_keeps_and_uses(labrig: Labrig, tmp_path: Path) -> None:
    """A mask of the rig file is recorded, and applied to every picture."""
    folder = Path(shutil.copytree(RIG.parent, tmp_path / "calibration"))
    cv2.imwrite(str(folder / "clamp.png"), np.full((224, 352), 255, np.uint8))
    one = ("--set", "insertions_per_specimen=1", "--set", "rig.calibration.mask=clamp.png")
    at = ("--rig", folder / RIG.name, "--runs-dir", tmp_path / "runs", "--json")
    run = Path(labrig("run", SWEEP, *SMALL_SWEEP, *one, *at).json()["run"])
    assert (run / "calibration" / "mask.png").read_bytes() == (folder / "clamp.png").read_bytes()
    result = json.loads((run / "analysis" / "001" / "result.json").read_text())
    assert not any(measurement["accepted"] for measurement in result["measurements"]), "everything is masked"
    assert "calibration/mask.png" in result["inputs"]
    assert labrig("replay", run, "--json").json()["identical"]


RECORD = ROOT / "tests" / "records" / "steerability"
CAMERA = "camera: {driver: files, source: pictures, width_px: 352, height_px: 224, rate_hz: 30}\n"
CALIBRATION = "calibration: {intrinsics: calibration/intrinsics.json, plane: calibration/plane.json}\n"


def _rig(folder: Path) -> Path:
    """Write the rig of a kept record, with the pictures of that record in place of its camera."""
    shutil.copytree(RECORD / "frames", folder / "pictures", dirs_exist_ok=True)
    shutil.copytree(RECORD / "calibration", folder / "calibration", dirs_exist_ok=True)
    text = (RECORD / "rig.yaml").read_text(encoding="utf-8")
    before, rest = text.split("camera:\n", 1)
    after = rest.split("recording:\n", 1)[1]
    path = folder / "rig.yaml"
    path.write_text(f"{before}{CAMERA}{CALIBRATION}recording:\n{after}", encoding="utf-8")
    return path


def _frames(run: Path) -> list[dict[str, Any]]:
    return [decode_line(line) for line in (run / "frames.jsonl").read_bytes().splitlines()]


@pytest.mark.processors
def test_a_sweep_runs_whole_on_the_pictures_of_another(labrig: Labrig, tmp_path: Path) -> None:
    """Its radii are theirs to 1 % of sigma; the page says `recorded pictures`, no truth is recorded; it replays."""
    runs_dir = ("--runs-dir", tmp_path / "runs", "--json")
    done = labrig("run", RECORD / "protocol.yaml", "--rig", _rig(tmp_path), *runs_dir)
    assert done.exit_code == 0, done.err
    run = Path(done.json()["run"])
    before = json.loads((RECORD / "analysis" / "001" / "result.json").read_text(encoding="utf-8"))
    after = json.loads((run / "analysis" / "001" / "result.json").read_text(encoding="utf-8"))
    sigma_mm = before["measurements"][-1]["sigma_radius_mm"]
    assert after["mean_radius_mm"] == pytest.approx(before["mean_radius_mm"], abs=0.01 * sigma_mm)
    assert [line["sha256"] for line in _frames(run)] == [line["sha256"] for line in _frames(RECORD)]
    camera = open_run(run).devices["camera"]
    assert (camera["driver"], camera["device"], camera["recorded_pictures"]) == ("files", "pictures", True)
    assert "recorded pictures</span>" in (run / "report.html").read_text(encoding="utf-8")
    assert after.get("truth") is None
    assert labrig("runs", "check", run).exit_code == 0
    assert labrig("replay", run, "--json").json()["verdict"] == "identical"


def test_real_drives_are_not_steered_by_recorded_pictures(labrig: Labrig, tmp_path: Path) -> None:
    """An insertion and a roll zero are refused before anything is opened; a sweep with fixed moves is accepted."""
    text = (ROOT / "calibration" / "rig-bench.yaml").read_text(encoding="utf-8")
    before, rest = text.split("camera:\n", 1)
    after = rest.split("\n\n", 1)[1]
    rig = tmp_path / "rig.yaml"
    rig.write_text(
        f"{before}camera: {{driver: files, source: p, width_px: 64, height_px: 48, rate_hz: 30}}\n\n{after}",
        encoding="utf-8",
    )

    def _collect_output(protocol: str) -> str:
        done = labrig("check", ROOT / "protocols" / protocol, "--rig", rig, "--json")
        return " ".join(problem["message"] for problem in done.json()["problems"])

    words = "moves real drives by what its pictures show, and camera.driver files gives recorded pictures"
    assert f"insertion {words}" in _collect_output("insertion.yaml")
    assert f"roll-zero {words}" in _collect_output("roll-zero.yaml")
    assert words not in _collect_output("steerability.yaml")
    assert labrig("run", ROOT / "protocols" / "insertion.yaml", "--rig", rig).exit_code == 2


def test_devices_check_says_that_pictures_are_recorded(labrig: Labrig, tmp_path: Path) -> None:
    """`labrig devices check` states that the pictures are recorded and never steer."""
    done = labrig("devices", "check", "--rig", _rig(tmp_path))
    assert "352x224 px, recorded pictures of pictures: they never steer" in done.out


def test_a_run_shown_live_is_the_same_run(
    labrig: Labrig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its record is whole and replays to the last bit, as that of a run that nobody watched; view.rrd is kept."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    done = labrig("run", *of_protocol("steerability"), "--runs-dir", tmp_path, "--run-name", "run", "--live")
    assert done.exit_code == 0, done.err
    assert (tmp_path / "run" / "view.rrd").stat().st_size > 10_000
    assert check_run(tmp_path / "run").damage == ()
    assert labrig("replay", tmp_path / "run", "--json").json()["identical"] is True


@pytest.mark.parametrize("program", ["stalled", "missing"])
def test_a_viewer_that_fails_is_told_once(
    program: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One that accepts and never reads, or does not start, leaves the record as it is."""
    viewer = tmp_path / "rerun"
    stalled = f"cd '{ROOT}' && exec '{sys.executable}' -m tests.cli.stalled_viewer \"$@\""
    viewer.write_text(f"#!/bin/sh\n{stalled if program == 'stalled' else 'exit 1'}\n")
    viewer.chmod(0o755)
    run = record_sweep(tmp_path, SyntheticSweep(radii_mm={"gel": (28.0,)}, gelatin_percent=(13,)))
    follower = Follower("viewer", str(viewer))
    follower.follow(run.path)
    follower.finish(3.0 if program == "stalled" else 120.0)
    said = [line for line in capsys.readouterr().err.splitlines() if "live view: nothing" in line]
    assert len(said) == (0 if program == "stalled" else 1)
    assert check_run(run.path).damage == ()


@pytest.mark.slow
def test_a_browser_is_told_before_the_run_and_stays_after_it(tmp_path: Path) -> None:
    """Until Ctrl+C the page is served; then the run's exit code is returned."""
    words = (
        "run",
        *of_protocol("steerability"),
        "--live",
        "web",
        "--runs-dir",
        tmp_path,
        "--run-name",
        "run",
    )
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


@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        (["run", "--live", "p.yaml"], ["run", "--live", "viewer", "p.yaml"]),
        (["run", "p.yaml", "--live"], ["run", "p.yaml", "--live", "viewer"]),
        (["run", "p.yaml", "--live", "web", "--yes"], ["run", "p.yaml", "--live", "web", "--yes"]),
    ],
)
def test_live_alone_is_the_viewer(typed: list[str], completed: list[str]) -> None:
    """The parser knows no option whose value may be left out."""
    assert complete_live(typed) == completed


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
    assert "would be 0.00 mm from hole 1 of run one, at 0 mm" in problem["message"]
    refused = labrig("run", protocol, *SHORT, "--run-name", "none")
    assert (refused.exit_code, (bench / "data/runs/none").exists()) == (2, False)
    place_mm = float(problem["hint"].split("first_hole_mm: ")[1].split(" ")[0])
    made = labrig(
        "run",
        protocol,
        *SHORT,
        "--set",
        f"specimens.0.first_hole_mm={place_mm}",
        "--run-name",
        "two",
        "--json",
    )
    assert made.exit_code == 0
    run = bench / "data" / "runs" / "two"
    assert list_places_mm(run) == [place_mm]
    shown = labrig("specimens", "A1", "--json").json()
    assert [track["hole_position_mm"] for track in shown["tracks"]["simulated"]] == [0.0, place_mm]
    assert shown["tracks"]["real"] == []
    assert "\ntracks of simulated runs:\n" in labrig("specimens", "A1").out
    assert labrig("replay", run, "--json").json()["identical"] is True
    start_s = float(open_run(run).trials["start_t_s"][0])
    cut = cut_short(run, run.with_name("cut"), start_s + 8.0)
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


def test_the_axes_stop_and_the_record_says_why(tmp_path: Path) -> None:
    """Exit code 3, a readable run closed as failed with the reason, and every acknowledged picture in it."""
    words = ["run", SWEEP, "--runs-dir", tmp_path, "--run-name", "run", "--json", *SMALL_SWEEP]
    command = [sys.executable, "-m", "labrig", *map(str, words), "--set", "insertions_per_specimen=18"]
    script = ["bash", "-c", 'ulimit -f 1100; exec "$@"', "bash"]
    done = subprocess.run([*script, *command], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, "Traceback" in done.stderr) == (3, False)
    assert json.loads(done.stdout)["exit_status"] == "failed"
    run = open_run(tmp_path / "run")
    assert (run.manifest["exit_status"], "File too large" in str(run.manifest["reason"])) == ("failed", True)
    assert (run.damage, check_run(tmp_path / "run").damage) == ((), ())
    assert list(run.events["kind"])[-1] == "run_stop"
    assert len(list(run.pictures)) == len(run.frame_table) > 5


@pytest.mark.parametrize(
    "line",
    [
        "runs annotate open --tag pilot",
        "runs annotate closed --note cloudy",
        "reanalyze closed",
        "report closed",
        "export closed --format csv --out tables",
    ],
)
def test_a_command_on_a_full_disk_says_so_and_changes_nothing(
    line: str, labrig: Labrig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exit code 3 with the file; no run is touched."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "tests" / "records" / "steerability", "closed")
    killed_run(tmp_path, "open")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with full_disk():
        done = labrig(*line.split())
    assert (done.exit_code, "Traceback" in done.err) == (3, False)
    assert "File too large" in done.err
    after = {
        path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file() and path.name[0] != "."
    }
    assert after == {path: content for path, content in before.items() if path.name[0] != "."}


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


ONE_INSERTION = (
    "--set", "insertions_per_specimen=1", "--set", "specimens=[{name: gel-10, gelatin_percent: 10}]",
    "--set", "rig.world.bubbles_per_specimen=0",
)  # fmt: skip
FAULTS = ("silent", "emergency, code: 0x8611", "unplugged")


def _places(err: str, *words: str) -> list[int]:
    """Return where lines begin with these words; the first line has no line of progress before it in a quick run."""
    return [f"\n{err}".find(f"\n{word}") for word in words]


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_motion_place_remedy_and_record_are_said_in_this_order(
    fault: str, labrig: Labrig, tmp_path: Path
) -> None:
    """A person reads first what the needle is doing; lost drives are told before anything else."""
    axis = "null" if fault == "unplugged" else "insertion"
    script = ("--set", f"rig.faults=[{{fault: {fault}, axis: {axis}, at_s: 40}}]")
    done = labrig("run", SWEEP, "--rig", RIG, "--runs-dir", tmp_path, "--json", *ONE_INSERTION, *script)
    document = done.json()
    is_lost = not fault.startswith("emergency")
    motion = "needle: not every axis is known" if is_lost else "needle: every axis stands still"
    places = _places(
        done.err, motion, "positions: insertion ", "error: ", "hint: ", "then: ", "the record is kept: "
    )
    assert (done.exit_code, places) == (3, sorted(places)), done.err
    assert places[0] >= 0, done.err
    told = done.err.find("press the emergency stop; what the needle is doing is not known")
    assert (0 <= told < places[0]) is is_lost
    needle = document["needle"]
    assert (needle["motion"], needle["in_tissue"]) == ("unknown" if is_lost else "standing still", True)
    assert [axis["axis"] for axis in needle["axes"]] == ["insertion", "rotation", "linear"]
    assert needle["axes"][0]["position"] == pytest.approx(35, abs=1)
    assert (needle["axes"][0]["age_s"] > 0) is is_lost
    assert document["run"] in done.err
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
    is_lost = fault == "silent"
    motion = "not every axis is known to stand still: press" if is_lost else "every axis stands still; no"
    places = _places(done.err, f"needle: {motion}", "positions: linear ", "error: ", "hint: ")
    assert (places, places[0] >= 0) == (sorted(places), True), done.err
    told = done.err.find("the drive of axis linear does not answer: press the emergency stop")
    assert (0 <= told < places[0]) is is_lost
