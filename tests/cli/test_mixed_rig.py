"""A rig with two kinds of drives on a bus: EPOS2 for insertion and linear, CiA 402 for the rotation."""

import re
import shutil
from pathlib import Path

import pytest

from labrig.record import open_run
from tests.cli.conftest import RIG, SHORT_SWEEP, SWEEP, Labrig
from tests.cli.example_runs import of_protocol
from tests.devices.eds_text import eds_text

pytestmark = pytest.mark.slow

ROTATION = """\
  rotation:
    driver: cia402
    node_id: 2
    eds: drives/epos4.eds
    unit: rad
    counts_per_turn: 2000
    velocity_unit: rpm
    acceleration_unit: rpm/s
    referenced_bit: 15
    objects: {home_position: "0x30B0:00", counts_per_turn: "0x3000:05", current_limit_ma: "0x3001:02"}
    gear_ratio: 16
    lead_mm: null
    limits: [-13, 13]
    max_speed: 6.283185307179586
    acceleration: 20
    quick_stop_deceleration: 80
    position_window: 0.001
    max_following_error: 0.1
"""
CHECK = ("check", SWEEP, *SHORT_SWEEP)


@pytest.fixture(name="mixed")
def _mixed(tmp_path: Path) -> Path:
    """Return the rig file of a mixed rig, with the EDS file beside it."""
    folder = Path(shutil.copytree(RIG.parent, tmp_path / "rig"))
    text = re.sub(r"  rotation:\n(?:    .*\n)+", ROTATION, RIG.read_text(encoding="utf-8"), count=1)
    (folder / "rig.yaml").write_text(text, encoding="utf-8")
    (folder / "drives").mkdir()
    (folder / "drives" / "epos4.eds").write_text(eds_text(), encoding="ascii")
    return folder / "rig.yaml"


def _change(rig: Path, old: str, new: str) -> None:
    text = rig.read_text(encoding="utf-8")
    assert text.count(old) == 1
    rig.write_text(text.replace(old, new), encoding="utf-8")


def _eds(rig: Path) -> Path:
    return rig.parent / "drives" / "epos4.eds"


def test_a_sweep_on_two_kinds_of_drives_replays(labrig: Labrig, mixed: Path, tmp_path: Path) -> None:
    """The run keeps the EDS file, so the replay does not need the rig's folder."""
    words = ("--rig", mixed, "--runs-dir", tmp_path / "runs", "--yes", "--json")
    done = labrig("run", *of_protocol("steerability"), *words)
    assert done.exit_code == 0, done.err
    run = Path(done.json()["run"])
    assert (run / "calibration" / "rotation-eds.eds").read_bytes() == _eds(mixed).read_bytes()
    devices = open_run(run).devices["axes"]
    models = {name: axis["drive"]["model"] for name, axis in devices.items()}
    assert models == {"insertion": "EPOS2 24/5", "rotation": "EPOS4 Module 50/5", "linear": "EPOS2 24/5"}
    assert devices["rotation"]["drive_settings"]["0x6007:00"] == 1
    moves = open_run(run).events.dropna(subset=["sent_counts", "sent_speed_units"])
    assert {"insertion", "rotation"} <= set(moves["axis"])
    shutil.rmtree(mixed.parent)
    assert labrig("replay", run, "--json").json()["verdict"] == "identical"
    for command in (("runs", "check", run), ("reanalyze", run), ("report", run)):
        assert labrig(*command).exit_code == 0


def test_the_rig_is_checked_with_both_kinds(labrig: Labrig, mixed: Path) -> None:
    """`devices check` identifies each drive, and warns of missing guards."""
    done = labrig("devices", "check", "--rig", mixed, "--json")
    checks = {check["check"]: check for check in done.json()}
    for name in ("drive insertion", "drive rotation", "guards rotation"):
        assert checks[name]["status"] == "PASS"
    assert "EPOS4 Module 50/5, product code 0x61500000" in checks["drive rotation"]["value"]
    _eds(mixed).write_text(eds_text(without=[0x6007, 0x607D, 0x60FD]))
    warned = labrig("devices", "check", "--rig", mixed).out
    for words in ("heartbeat stops (0x6007)", "lower limit in the drive (0x607D:01)"):
        assert words in warned


def test_a_drive_without_a_current_limit_needs_current_0(labrig: Labrig, mixed: Path) -> None:
    """It jogs with --current-ma 0."""
    _change(mixed, ', current_limit_ma: "0x3001:02"', "")
    jog = ("devices", "jog", "--axis", "rotation", "--distance", "0.5", "--rig", mixed)
    refused = labrig(*jog)
    assert (refused.exit_code, "--current-ma 0" in refused.err) == (3, True)
    assert "no current limit that labrig can set, asked for 1000 mA" in refused.err
    assert labrig(*jog, "--current-ma", "0").exit_code == 0


def test_a_rig_whose_eds_file_is_missing_moves_nothing(labrig: Labrig, mixed: Path, tmp_path: Path) -> None:
    """`check`, `run` and `devices check` name the key and the file."""
    _eds(mixed).unlink()
    run = ("run", *CHECK[1:], "--runs-dir", tmp_path / "runs", "--yes")
    for line, exit_code in ((CHECK, 1), (run, 2), (("devices", "check"), 1)):
        done = labrig(*line, "--rig", mixed)
        assert (done.exit_code, "epos4.eds: No such file" in done.out + done.err) == (exit_code, True), line
    assert not list((tmp_path / "runs").glob("*"))


@pytest.mark.parametrize(
    ("old", "new", "exit_code", "words"),
    [
        (0x6098, None, 1, "has no object 0x6098:00 (homing method)"),
        (0x1016, None, 1, "has no object 0x1016:01 (consumer heartbeat)"),
        (0x30B0, None, 1, "has no object 0x30B0:00"),
        ("eds: drives/epos4.eds", "eds: ../rig/../../epos4.eds", 1, "leaves the folder of the rig file"),
        ("eds: drives/epos4.eds", "eds: /etc/passwd", 1, "leaves the folder of the rig file"),
        ("error: 0.1\n", "error: 0.1\n    homing: {offset: 0.2}\n", 1, "homing has position 0 and offset 0.2"),
        ("max_speed: 6.283185307179586", "max_speed: 1e9", 1, "(0x607F:00) would be"),
        ("node_id: 2\n    eds", "node: 2\n    eds", 2, "node"),
        ("velocity_unit: rpm", "velocity_unit: rev/min", 2, "velocity_unit"),
        ("    velocity_unit: rpm\n", "", 2, "velocity_unit"),
        ("referenced_bit: 15", "referenced_bit: 3", 2, "referenced_bit"),
        ('home_position: "0x30B0:00"', "home_position: 0x30B0", 2, "objects.home_position"),
        ("error: 0.1\n", "error: 0.1\n    homing: {method: -3}\n", 2, "method"),
    ],
)  # fmt: skip
def test_a_section_that_does_not_fit_its_drive_is_refused(
    labrig: Labrig, mixed: Path, old: str | int, new: str, exit_code: int, words: str
) -> None:
    """Objects that the drive lacks, files elsewhere, values beyond its ranges; a wrong key by its line."""
    if isinstance(old, int):
        _eds(mixed).write_text(eds_text(without=[old]), encoding="ascii")
    else:
        _change(mixed, old, new)
    done = labrig(*CHECK, "--rig", mixed)
    told = " ".join((done.out + done.err).split())
    assert (done.exit_code, words in told) == (exit_code, True), told
    assert (re.search(r"rig\.yaml:\d+:\d+", told) is not None) == (exit_code == 2)
