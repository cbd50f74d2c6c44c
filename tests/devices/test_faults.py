"""Faults that a rig file scripts: read, refused if invalid, and carried out when due."""

from pathlib import Path

import pytest

from labrig.devices.drives import objects as co
from labrig.devices.rig_file import RigDescription, load_rig
from labrig.devices.simulated.hardware import SimulatedHardware
from labrig.errors import FileFormatError
from tests.devices.rigs import instants, rig_text


def _scripted(folder: Path, script: str) -> RigDescription:
    path = folder / "rig.yaml"
    path.write_text(rig_text({"\ncan:": f"\nfaults:\n  - {script}\n\ncan:"}), encoding="utf-8")
    return load_rig(path)


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("{fault: silent}", "needs an axis"),
        ("{fault: bus-off, axis: linear}", "has no axis"),
        ("{fault: emergency, axis: linear}", "needs a code"),
        ("{fault: boot-up, axis: linear, code: 1}", "has no code"),
        ("{fault: unplugged, once: moving}", "waits for no axis"),
        ("{fault: input, axis: linear}", "needs a source"),
        ("{fault: blocked, axis: linear, source: analog-1}", "has no source"),
        ("{fault: gremlins}", "faults"),
    ],
)
def test_an_invalid_fault_is_refused(tmp_path: Path, script: str, words: str) -> None:
    """The error says what the fault needs, with its place in the file."""
    with pytest.raises(FileFormatError, match=words):
        _scripted(tmp_path, script)


def test_a_fault_waits_for_its_time_and_for_the_axis(tmp_path: Path) -> None:
    """It occurs after `at_s` and only while the axis moves; the drive's journal has the instant."""
    rig = _scripted(tmp_path, "{fault: boot-up, axis: insertion, at_s: 1, once: moving}")
    assert rig.world is not None
    hardware = SimulatedHardware(rig, rig.world, seed=1)
    hardware.clock.sleep(2.0)
    assert len(hardware.faults.waiting) == 1
    drive = hardware.drives["insertion"]
    drive.objects.put(co.TARGET_POSITION, 100_000)
    for word in (0x06, 0x0F, 0x3F):
        drive.objects.put(co.CONTROLWORD, word)
    hardware.clock.sleep(0.1)
    assert instants(drive, "boot")[-1] == drive.shaft.still_s == 2.1
    hardware.close()
