"""A rig with two kinds of drives on a bus: EPOS2 for insertion and linear, CiA 402 for the rotation."""

import json
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest

from labrig.record import open_run
from tests.cli.conftest import RIG, SHORT_SWEEP, SWEEP, Done, Labrig
from tests.cli.example_runs import SHORTENED
from tests.devices.cia402.eds_text import eds_text

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


@dataclass(frozen=True)
class MixedRig:
    """The rig file of a mixed rig, and the EDS file beside it."""

    path: Path
    eds: Path

    def change(self, old: str, new: str) -> None:
        """Replace a stretch of the rig file."""
        text = self.path.read_text(encoding="utf-8")
        assert text.count(old) == 1
        self.path.write_text(text.replace(old, new), encoding="utf-8")


@pytest.fixture(name="mixed")
def _mixed(tmp_path: Path) -> MixedRig:
    text = RIG.read_text(encoding="utf-8")
    text, replaced = re.subn(r"  rotation:\n(?:    .*\n)+", ROTATION, text, count=1)
    assert replaced == 1
    folder = tmp_path / "rig"
    (folder / "drives").mkdir(parents=True)
    for file in RIG.parent.glob("simulated-*"):
        shutil.copy(file, folder)
    (folder / "rig.yaml").write_text(text, encoding="utf-8")
    (folder / "drives" / "epos4.eds").write_text(eds_text(), encoding="ascii")
    return MixedRig(folder / "rig.yaml", folder / "drives" / "epos4.eds")


def test_a_sweep_on_two_kinds_of_drives_replays(labrig: Labrig, mixed: MixedRig, tmp_path: Path) -> None:
    """The run keeps the EDS file, so the replay does not need the rig's folder."""
    short = (word for setting in SHORTENED["steerability"] for word in ("--set", setting))
    done = labrig(
        "run", SWEEP, *short, "--rig", mixed.path, "--runs-dir", tmp_path / "runs", "--yes", "--json"
    )
    assert done.exit_code == 0, done.err
    (run,) = (tmp_path / "runs").iterdir()
    assert (run / "calibration" / "rotation-eds.eds").read_bytes() == mixed.eds.read_bytes()
    devices = open_run(run).devices["axes"]
    models = {name: axis["drive"]["model"] for name, axis in devices.items()}
    assert models == {"insertion": "EPOS2 24/5", "rotation": "EPOS4 Module 50/5", "linear": "EPOS2 24/5"}
    assert devices["rotation"]["drive_settings"]["0x6007:00"] == 1
    moves = [json.loads(line) for line in (run / "events.jsonl").read_text().splitlines() if '"move"' in line]
    sent = {
        move["axis"]: {key for key in move if key.startswith("sent_")}
        for move in moves
        if "sent_" in str(move)
    }
    assert sent["insertion"] == {"sent_counts", "sent_speed_units"}
    assert sent.get("rotation", {"sent_counts", "sent_speed_units"}) == {"sent_counts", "sent_speed_units"}
    shutil.rmtree(mixed.path.parent)
    replayed = labrig("replay", run, "--json")
    assert replayed.exit_code == 0, replayed.out
    assert replayed.json()["verdict"] == "identical"
    for command in (("runs", "check", run), ("reanalyze", run), ("report", run)):
        assert labrig(*command).exit_code == 0


def test_the_rig_is_checked_with_both_kinds(labrig: Labrig, mixed: MixedRig) -> None:
    """`devices check` identifies each drive, and warns of missing guards."""
    done = labrig("devices", "check", "--rig", mixed.path, "--json")
    checks = {check["check"]: check for check in done.json()}
    assert checks["drive insertion"]["status"] == checks["drive rotation"]["status"] == "PASS"
    assert "EPOS4 Module 50/5, product code 0x61500000" in checks["drive rotation"]["value"]
    assert checks["guards rotation"]["status"] == "PASS"
    mixed.eds.write_text(eds_text(without=[0x6007, 0x607D, 0x60FD]))
    warned = labrig("devices", "check", "--rig", mixed.path).out
    for words in ("heartbeat stops (0x6007)", "lower limit in the drive (0x607D:01)"):
        assert words in warned


def test_a_drive_without_a_current_limit_needs_current_0(labrig: Labrig, mixed: MixedRig) -> None:
    """It jogs with --current-ma 0."""
    mixed.change(', current_limit_ma: "0x3001:02"', "")
    jog = ("devices", "jog", "--axis", "rotation", "--distance", "0.5", "--rig", mixed.path)
    refused = labrig(*jog)
    assert refused.exit_code == 3
    assert "no current limit that labrig can set, asked for 1000 mA" in refused.err
    assert "--current-ma 0" in refused.err
    assert labrig(*jog, "--current-ma", "0").exit_code == 0


BAD_EDS = {
    "missing": (None, "epos4.eds: No such file"),
    "malformed": ("VendorNumber=1", "is not an EDS file"),
    "without homing": (eds_text(without=[0x6098]), "has no object 0x6098:00 (homing method)"),
    "without the dead-man": (eds_text(without=[0x1016]), "has no object 0x1016:01 (consumer heartbeat)"),
    "of an object that makes no sense": (
        eds_text(without=[0x6040]) + "[6040]\nParameterName=x\nDataType=word\nAccessType=rw\n",
        "is not an EDS file: ValueError: invalid literal",
    ),
    "without the object that is named": (eds_text(without=[0x30B0]), "has no object 0x30B0:00"),
}


@pytest.mark.parametrize(("text", "words"), BAD_EDS.values(), ids=BAD_EDS)
def test_an_unusable_eds_file_is_refused_before_anything_moves(
    labrig: Labrig, mixed: MixedRig, text: str | None, words: str, tmp_path: Path
) -> None:
    """`check`, `run` and `devices check` name the key, the object and a remedy."""
    mixed.eds.unlink()
    if text is not None:
        mixed.eds.write_text(text, encoding="ascii")

    def join_problems(done: Done) -> str:
        return " ".join((done.out + done.err).split())

    checked = labrig("check", SWEEP, *SHORT_SWEEP, "--rig", mixed.path)
    assert checked.exit_code == 1
    assert words in join_problems(checked)
    assert "rig axes.rotation." in join_problems(checked)
    ran = labrig("run", SWEEP, *SHORT_SWEEP, "--rig", mixed.path, "--runs-dir", tmp_path / "runs", "--yes")
    assert ran.exit_code == 2
    assert words in join_problems(ran)
    assert not list((tmp_path / "runs").glob("*"))
    devices = labrig("devices", "check", "--rig", mixed.path)
    assert devices.exit_code == 1
    assert words in join_problems(devices)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("eds: drives/epos4.eds", "eds: ../rig/../../epos4.eds", "leaves the folder of the rig file"),
        ("eds: drives/epos4.eds", "eds: /etc/passwd", "leaves the folder of the rig file"),
        ("error: 0.1\n", "error: 0.1\n    homing: {offset: 0.2}\n", "homing has position 0 and offset 0.2"),
        ("max_speed: 6.283185307179586", "max_speed: 1e9", "(0x607F:00) would be"),
    ],
)
def test_a_section_that_does_not_fit_its_drive_is_refused(
    labrig: Labrig, mixed: MixedRig, old: str, new: str, words: str
) -> None:
    """Files out of the rig's folder, a homing that the drive lacks, values beyond its ranges."""
    mixed.change(old, new)
    done = labrig("check", SWEEP, *SHORT_SWEEP, "--rig", mixed.path)
    assert done.exit_code == 1
    assert words in " ".join((done.out + done.err).split())


BAD_SECTION = [
    ("node_id: 2\n    eds", "node: 2\n    eds", "node"),
    ("velocity_unit: rpm", "velocity_unit: rev/min", "velocity_unit"),
    ("    velocity_unit: rpm\n", "", "velocity_unit"),
    ("referenced_bit: 15", "referenced_bit: 3", "referenced_bit"),
    ('home_position: "0x30B0:00"', "home_position: 0x30B0", "objects.home_position"),
    (
        "    gear_ratio: 16\n    lead_mm: null\n",
        "    gear_ratio: 16\n    lead_mm: null\n    homing: {method: -3}\n",
        "method",
    ),
]


@pytest.mark.parametrize(("old", "new", "words"), BAD_SECTION)
def test_an_invalid_section_is_refused_with_its_line(
    labrig: Labrig, mixed: MixedRig, old: str, new: str, words: str
) -> None:
    """Keys that the driver lacks, and values out of range."""
    mixed.change(old, new)
    done = labrig("devices", "check", "--rig", mixed.path)
    assert done.exit_code == 2
    assert words in " ".join(done.err.split())
    assert re.search(r"rig\.yaml:\d+:\d+", done.err)
