"""Faults that a rig file scripts: read, refused if invalid, and carried out when due."""

from pathlib import Path

import pytest

from labrig.devices.drives import objects as co
from labrig.devices.fault_script import FaultDescription
from labrig.devices.rig_file import RigDescription, load_rig
from labrig.devices.simulated.hardware import SimulatedHardware
from labrig.errors import FileFormatError
from tests.devices.rigs import epos2_drives, rig_text, simulated_rig


def _hardware(*faults: FaultDescription) -> SimulatedHardware:
    description: RigDescription = simulated_rig().model_copy(update={"faults": faults})
    assert description.world is not None
    return SimulatedHardware(description, description.world, seed=1)


def _move(hardware: SimulatedHardware) -> None:
    """Set the insertion moving, behind everybody's back."""
    objects = epos2_drives(hardware)["insertion"].objects
    objects.put(co.TARGET_POSITION, 100_000)
    for word in (0x06, 0x0F, 0x3F):
        objects.put(co.CONTROLWORD, word)


def test_a_rig_file_scripts_faults(tmp_path: Path) -> None:
    """The section `faults` is read with its defaults."""
    path = tmp_path / "rig.yaml"
    script = "faults:\n  - {fault: boot-up, axis: linear, at_s: 2, once: moving}\n\ncan:"
    path.write_text(rig_text({"\ncan:": "\n" + script}), encoding="utf-8")
    (fault,) = load_rig(path).faults
    assert (fault.fault, fault.axis, fault.at_s, fault.once) == ("boot-up", "linear", 2.0, "moving")


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
    path = tmp_path / "rig.yaml"
    path.write_text(rig_text({"\ncan:": f"\nfaults:\n  - {script}\n\ncan:"}), encoding="utf-8")
    with pytest.raises(FileFormatError, match=words):
        load_rig(path)


def test_a_fault_waits_for_its_time_and_for_the_axis() -> None:
    """It occurs after `at_s` and only while the axis moves; the drive's journal has the instant."""
    hardware = _hardware(FaultDescription(fault="boot-up", axis="insertion", at_s=1.0, once="moving"))
    hardware.clock.sleep(2.0)
    assert hardware.faults.happened == []
    _move(hardware)
    hardware.clock.sleep(0.1)
    ((happened_s, _),) = hardware.faults.happened
    boot = hardware.drives["insertion"].find_last("boot")
    assert boot is not None
    assert boot.t_s == hardware.drives["insertion"].shaft.still_s == happened_s == 2.1
    hardware.close()
