"""Only one labrig uses a rig, and another one can stop it."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from labrig.devices.can_description import CanDescription
from labrig.devices.check import check_rig
from labrig.devices.clocks import SimulatedClock
from labrig.devices.exclusive import acquire_rig, find_owner, name_bus
from labrig.devices.needle_state import NeedleState
from labrig.devices.rig import Rig, open_rig
from labrig.devices.rig_file import RigDescription, load_rig
from labrig.devices.stop import StopTarget, read_stop_target, stop_rig
from labrig.errors import FileFormatError, LockedError, OutputExistsError
from labrig.record.lock import LockOwner
from tests.devices.rigs import BENCH, SIMULATED, Person, Signal, rig_text, simulated_rig


def _make_rig(tmp_path: Path) -> RigDescription:
    return simulated_rig("state_file=state.json").placed_in(tmp_path)


def _open(rig: RigDescription, doing: str = "labrig") -> AbstractContextManager[Rig]:
    return open_rig(rig, seed=1, person=Person(), interrupted=Signal(), doing=doing)


def _target(tmp_path: Path) -> StopTarget:
    return replace(read_stop_target(SIMULATED), state_path=tmp_path / "state.json")


def test_only_one_labrig_uses_a_rig_at_a_time(tmp_path: Path) -> None:
    """A second one is refused with the name of the first; the rig is free when that ends."""
    rig = _make_rig(tmp_path)
    with _open(rig, "labrig run a.yaml"):
        with (
            pytest.raises(LockedError, match=r"in use by labrig run a.yaml \(process \d+ on ") as refused,
            _open(rig),
        ):
            pass
        assert "labrig devices stop" in refused.value.hint
        assert find_owner(rig.state_path) == LockOwner("labrig run a.yaml", os.getpid(), os.uname().nodename)
    assert find_owner(rig.state_path) is None
    with _open(rig):
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
    assert name_bus(simulated_rig().can) == ""


_HOLD = """
import os, sys
from pathlib import Path
from labrig.devices.exclusive import acquire_rig
from labrig.devices.rig_file import load_rig
rig = load_rig(Path(sys.argv[1]), sys.argv[3:]).placed_in(Path(sys.argv[2]))
if os.getuid() == 0:
    os.chown(sys.argv[2], 65534, 65534)
    os.setuid(65534)
with acquire_rig(rig, "labrig run other.yaml"):
    print("held", flush=True)
    sys.stdin.read()
"""


@contextmanager
def _held(file: Path, folder: Path, *overrides: str, code: str = _HOLD) -> Iterator[None]:
    """Let another process hold a rig until the block ends."""
    with subprocess.Popen(
        [sys.executable, "-c", code, str(file), str(folder), *overrides],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        yield
        assert other.stdin is not None
        other.stdin.close()
        other.wait()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux has names among all accounts")
def test_two_accounts_do_not_share_a_bus(tmp_path: Path) -> None:
    """A labrig of another account keeps the bus to itself until it has ended."""
    rig = load_rig(BENCH).placed_in(tmp_path)
    with tempfile.TemporaryDirectory() as theirs:
        with (
            _held(BENCH, Path(theirs), "state_file=other.json"),
            pytest.raises(LockedError, match=r"its bus socketcan can0 is in use by another labrig"),
            acquire_rig(rig, "labrig run mine.yaml"),
        ):
            pass
        with acquire_rig(rig, "labrig run mine.yaml"):
            pass


def test_a_labrig_that_does_not_end_is_named(tmp_path: Path) -> None:
    """One that hangs keeps the rig; the report says so, and what cannot be asked is not waited for."""
    code = _HOLD.replace("import os, sys", "import os, signal, sys\nsignal.signal(15, signal.SIG_IGN)")
    code = code.replace("if os.getuid() == 0:", "if False:")
    target = _target(tmp_path)
    with _held(BENCH.with_name("rig-simulated.yaml"), tmp_path, "state_file=state.json", code=code):
        assert "and it has not let go of the rig" in stop_rig(target, SimulatedClock())[0]
    with acquire_rig(_make_rig(tmp_path), "labrig run here.yaml"):
        assert "cannot be asked to end from here" in stop_rig(target)[0]


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
    path.write_text(rig_text({old: new}), encoding="utf-8")
    with pytest.raises(FileFormatError):
        load_rig(path)
    target = read_stop_target(path)
    assert target.can == simulated_rig().can
    assert {name: section.node_id for name, section in target.sections.items()} == {
        "insertion": 1,
        "rotation": 2,
        "linear": 3,
    }


@pytest.mark.parametrize("text", ["can: {interface: 7}\n", "axes: {}\n", "}\n", "- 1\n"])
def test_a_file_without_a_bus_says_to_press_the_emergency_stop(tmp_path: Path, text: str) -> None:
    """Nothing can be stopped with it."""
    (tmp_path / "rig.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(FileFormatError) as refused:
        read_stop_target(tmp_path / "rig.yaml")
    assert refused.value.hint.startswith("press the emergency stop")


@pytest.mark.parametrize("content", ["Notes of today.\n", '{"kind": "labrig-plane"}', "{"])
def test_a_state_file_never_replaces_a_file_of_something_else(tmp_path: Path, content: str) -> None:
    """A rig whose state_file names notes is not opened, devices check fails, and the notes are as they were."""
    rig, path = _make_rig(tmp_path), tmp_path / "state.json"
    path.write_text(content)
    with (
        pytest.raises(OutputExistsError, match=r"state\.json is named as the state file") as refused,
        _open(rig),
    ):
        pass
    assert ("state_file:" in refused.value.hint, path.read_text()) == (True, content)
    assert {result.check: result.status for result in check_rig(rig)}["rig state"] == "FAIL"


@pytest.mark.parametrize("content", ["", '{"kind": "labrig-rig-state", "schema_version": 1'])
def test_an_empty_or_torn_state_file_is_replaced(tmp_path: Path, content: str) -> None:
    """A file that labrig wrote, or an empty one, is replaced by the first change."""
    (tmp_path / "state.json").write_text(content)
    with _open(_make_rig(tmp_path)) as rig:
        assert rig.state.needle_in_tissue is None
        rig.needle.mark_out()
    assert NeedleState(tmp_path / "state.json").state.needle_in_tissue is False
