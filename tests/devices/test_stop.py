"""Only one labrig uses a rig, and another one can stop it; `labrig devices stop`, below the command line."""

import json
import os
import signal
import subprocess
import sys
import tempfile
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from labrig.devices.bus import open_can
from labrig.devices.can_description import CanDescription
from labrig.devices.clocks import SimulatedClock
from labrig.devices.drives.states import DriveState, decode_state
from labrig.devices.exclusive import acquire_rig, find_owner, name_bus
from labrig.devices.rig_file import load_rig
from labrig.devices.stop import read_stop_target, stop_drives, stop_rig
from labrig.errors import BusError, FileFormatError, LockedError, SafetyStopError
from labrig.record.lock import FileLock, LockOwner
from tests.devices.rigs import BENCH, SIMULATED, OpenedRig, opened_rig, ready_rig, rig_text, simulated_rig

TARGET = read_stop_target(SIMULATED)
STATEFUL = simulated_rig("state_file=state.json")


def test_only_one_labrig_uses_a_rig_at_a_time(tmp_path: Path) -> None:
    """A second one is refused with the name of the first; the rig is free when that ends."""
    rig = STATEFUL.placed_in(tmp_path)
    with acquire_rig(rig, "labrig run a.yaml"):
        with (
            pytest.raises(LockedError, match=r"in use by labrig run a.yaml \(process \d+ on ") as refused,
            acquire_rig(rig, "labrig run b.yaml"),
        ):
            pass
        assert "labrig devices stop" in refused.value.hint
        assert find_owner(rig.state_path) == LockOwner("labrig run a.yaml", os.getpid(), os.uname().nodename)
        assert "cannot be asked to end from here" in stop_rig(replace(TARGET, state_path=rig.state_path))[0]
    assert find_owner(rig.state_path) is None
    with acquire_rig(rig, "labrig run b.yaml"):
        pass


def test_a_bus_is_known_by_its_channel(tmp_path: Path) -> None:
    """Options make no other bus of it, nor does a link to a serial port; a simulated one is none."""
    (tmp_path / "ttyACM0").touch()
    (tmp_path / "by-id").symlink_to(tmp_path / "ttyACM0")

    def name(interface: str, channel: str | Path, **options: bool) -> str:
        return name_bus(CanDescription(interface=interface, channel=str(channel), options={**options}))

    assert name("socketcan", "can0") == name("socketcan", "can0", receive_own_messages=False)
    assert name("socketcan", "can0") != name("socketcan", "can1")
    assert name("slcan", tmp_path / "ttyACM0") == name("slcan", tmp_path / "by-id")
    assert name_bus(STATEFUL.can) == ""


_OTHER_ACCOUNT = """
import os, sys
from pathlib import Path
from labrig.devices.exclusive import acquire_rig
from labrig.devices.rig_file import load_rig
rig = load_rig(Path(sys.argv[1]), ["state_file=other.json"]).placed_in(Path(sys.argv[2]))
if os.getuid() == 0:
    os.chown(sys.argv[2], 65534, 65534)
    os.setuid(65534)
with acquire_rig(rig, "labrig run other.yaml"):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux has names among all accounts")
def test_two_accounts_do_not_share_a_bus(tmp_path: Path) -> None:
    """A labrig of another account keeps the bus to itself until it has ended."""
    rig = load_rig(BENCH).placed_in(tmp_path)
    with tempfile.TemporaryDirectory() as theirs:
        command = [sys.executable, "-c", _OTHER_ACCOUNT, str(BENCH), theirs]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
            assert other.stdout is not None
            assert other.stdout.readline() == b"held\n"
            with (
                pytest.raises(LockedError, match=r"its bus socketcan can0 is in use by another labrig"),
                acquire_rig(rig, "labrig run mine.yaml"),
            ):
                pass
            other.communicate(b"")
        with acquire_rig(rig, "labrig run mine.yaml"):
            pass


def test_a_labrig_that_does_not_end_is_named(tmp_path: Path) -> None:
    """It was asked to, by the signal for it; one that hangs keeps the rig, and the report says so."""
    with FileLock(tmp_path / "state.json.lock").acquire("labrig run other.yaml"):
        with subprocess.Popen(["sleep", "60"]) as other:
            owner = asdict(LockOwner("labrig run other.yaml", other.pid, os.uname().nodename))
            (tmp_path / "state.json.lock.owner").write_text(json.dumps(owner))
            done = stop_rig(replace(TARGET, state_path=tmp_path / "state.json"), SimulatedClock())
            assert other.wait(10) == -signal.SIGTERM
        assert done[0].startswith(f"asked labrig run other.yaml (process {other.pid}")
        assert done[0].endswith("to end, and it has not let go of the rig")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("calibration:\n", "calibrations:\n"),
        ("    max_following_error: 0.5\n", "    max_following_error: 0.5\n    homing: null\n"),
        ("    gear_ratio: 4\n", "    gear_ratio: four\n"),
        ("world:\n", "planet:\n"),
    ],
)
def test_a_rig_is_stopped_by_a_file_with_other_faults(tmp_path: Path, old: str, new: str) -> None:
    """Bus and nodes are enough."""
    path = tmp_path / "rig.yaml"
    path.write_text(rig_text(old, new), encoding="utf-8")
    with pytest.raises(FileFormatError):
        load_rig(path)
    target = read_stop_target(path)
    assert target.can == simulated_rig().can
    nodes = {name: section.node_id for name, section in target.sections.items()}
    assert nodes == {"insertion": 1, "rotation": 2, "linear": 3}


@pytest.mark.parametrize("text", ["can: {interface: 7}\n", "axes: {}\n", "}\n", "- 1\n"])
def test_a_file_without_a_bus_says_to_press_the_emergency_stop(tmp_path: Path, text: str) -> None:
    """Nothing can be stopped with it."""
    (tmp_path / "rig.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(FileFormatError) as refused:
        read_stop_target(tmp_path / "rig.yaml")
    assert refused.value.hint.startswith("press the emergency stop")


def _stop(opened: OpenedRig) -> tuple[str, ...]:
    return stop_drives(TARGET, opened.hardware.open_link(), opened.hardware.clock)


def test_stopping_from_outside_stops_every_drive() -> None:
    """Every quick stop is sent before one is answered; all are seen to stand still, and put into NMT STOPPED.

    Done again, the nodes, which answer no SDO now, are woken and read. A rig that is opened starts them, and nothing
    moves.
    """
    with ready_rig(moves=("insertion", 100.0, 1.0)) as opened:
        opened.rig.axis("linear").start_move(100.0, 5.0)
        opened.rig.wait(1.0)
        link = opened.hardware.open_link()
        done = stop_drives(TARGET, link, opened.hardware.clock)
        assert sum("stands still" in line for line in done) == 3
        assert done[-1] == "sent NMT stop to all nodes"
        requests = [data for _, can_id, data, way in link.network.take_frames() if way == "T" and can_id]
        assert requests[:3] == [b"\x2b\x40\x60\0\x02\0\0\0"] * 3
        positions = [drive.shaft_counts for drive in opened.drives.values()]
        opened.hardware.clock.sleep(1.0)
        assert sum("stands still" in line for line in _stop(opened)) == 3
        assert [drive.shaft_counts for drive in opened.drives.values()] == positions
    with opened_rig() as opened:
        _stop(opened)
        opened.hardware.clock.sleep(1.0)
        opened.rig.connect()
        assert decode_state(opened.rig.read_states()["linear"].statusword) is DriveState.OPERATION_ENABLED
        assert all(drive.shaft_counts == 0 for drive in opened.drives.values())


def test_stopping_from_outside_names_a_drive_that_does_not_answer() -> None:
    """The other drives are stopped all the same."""
    with ready_rig(moves=("linear", 100.0, 5.0)) as opened:
        opened.drives["insertion"].unplug()
        with pytest.raises(SafetyStopError, match=r"axis insertion \(node 1\) did not answer.*sent NMT stop"):
            _stop(opened)
        statusword = opened.drives["linear"]._statusword()
        # Meanwhile the rig did not beat, so that the drive has also stopped by itself.
        assert decode_state(statusword) in {DriveState.QUICK_STOP_ACTIVE, DriveState.FAULT}


def test_what_cannot_be_stopped_says_so() -> None:
    """A simulated rig has no bus to open; a bench without one must not look as if the drives had been stopped."""
    assert stop_rig(TARGET) == (
        "no labrig has the rig",
        "its drives are simulated inside the labrig that runs them: Ctrl+C there stops them",
    )
    with pytest.raises(BusError, match="socketcan can0 cannot be opened") as refusal:
        stop_rig(read_stop_target(BENCH))
    assert refusal.value.hint.startswith("press the emergency stop")


@pytest.mark.parametrize(
    ("interface", "channel", "hint"),
    [
        ("socketcan", "can0", "ip link set can0 up"),
        ("slcan", "/dev/no-such-adapter", "serial port of the adapter"),
        ("kvaser", "0", "whether its driver is installed"),
        ("pcan", "PCAN_X", "whether its driver is installed"),
    ],
)
def test_an_interface_that_cannot_be_opened_is_a_bus_error(interface: str, channel: str, hint: str) -> None:
    """Unknown, without driver or without adapter: one error with a hint about this interface, no traceback."""
    with pytest.raises(BusError, match=f"CAN interface {interface} {channel} cannot be opened") as refusal:
        open_can(CanDescription(interface=interface, channel=channel), SimulatedClock())
    assert hint in refusal.value.hint
