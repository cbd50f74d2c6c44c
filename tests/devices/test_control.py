"""One labrig a rig, and how another one stops it."""

import stat
import subprocess
import sys
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import pytest

from labrig.devices.control import ask_to_stop, find_owner, lock_paths
from labrig.devices.rig import Rig, open_rig
from labrig.devices.rig_file import RigDescription, load_rig
from labrig.devices.stop import StopReport, stop_rig
from labrig.errors import LockedError, SafetyStopError
from labrig.posix import call
from tests.devices.rigs import BENCH, Person, Signal, simulated_rig

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Unix sockets are POSIX's")


def _kept(tmp_path: Path) -> RigDescription:
    return simulated_rig("state_file=state.json").placed_in(tmp_path)


def _wait_for(asked: Future[StopReport], rig: Rig) -> None:
    while not asked.done():
        rig.wait(0.1)


def test_a_rig_is_had_by_one_labrig_at_a_time(tmp_path: Path) -> None:
    """The second is refused with who has it; once the first has ended, it is free."""
    rig = _kept(tmp_path)
    with open_rig(rig, seed=1, person=Person(), interrupted=Signal(), doing="labrig run a.yaml"):
        with (
            pytest.raises(
                LockedError, match=r"rig simulated is in use by labrig run a.yaml \(process \d+ on "
            ),
            open_rig(rig, seed=1, person=Person(), interrupted=Signal()),
        ):
            pass
        assert "labrig run a.yaml" in find_owner(rig)
    assert find_owner(rig) == ""
    with open_rig(rig, seed=1, person=Person(), interrupted=Signal()):
        pass


def test_the_lock_of_a_killed_labrig_is_stale(tmp_path: Path) -> None:
    """A process that was killed with the rig open keeps nobody out."""
    code = (
        "import os,sys;from pathlib import Path;from labrig.record.lock import FileLock\n"
        f"FileLock(Path({str(lock_paths(_kept(tmp_path))[0])!r})).acquire('labrig run dead.yaml');os._exit(9)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 9
    with open_rig(_kept(tmp_path), seed=1, person=Person(), interrupted=Signal()):
        pass


def test_rig_files_with_the_same_nodes_exclude_each_other(tmp_path: Path) -> None:
    """Locks are of the bus and its nodes as well as of the state file; another channel is another bus."""
    first, second = load_rig(BENCH), load_rig(BENCH, ["state_file=other.json"])
    elsewhere = load_rig(BENCH, ["state_file=other.json", "can.channel=can1"])
    assert len(set(lock_paths(first)) & set(lock_paths(second))) == 3
    assert not set(lock_paths(first)) & set(lock_paths(elsewhere))
    assert lock_paths(simulated_rig()) == ()


@pytest.mark.parametrize("depth", [1, 12])
def test_a_moving_rig_is_stopped_by_another_labrig(tmp_path: Path, depth: int) -> None:
    """The one that moves stops, sees every axis stand still, and says so; its wait ends in an error."""
    folder = tmp_path.joinpath(*["folder with a long name"] * depth)
    folder.mkdir(parents=True)
    rig = _kept(folder)
    with (
        ThreadPoolExecutor(1) as pool,
        open_rig(rig, seed=1, person=Person(), interrupted=Signal(), doing="labrig run b.yaml") as moving,
    ):
        socket = folder / "state.json.socket"
        assert stat.S_IMODE(socket.stat().st_mode) == 0o600
        moving.needle.mark_out()
        moving.reference_axes()
        moving.insertion.start_move(100.0, 1.0)
        asked = pool.submit(stop_rig, rig)
        with pytest.raises(SafetyStopError, match="stopped by labrig devices stop"):
            _wait_for(asked, moving)
        report = asked.result()
        assert report.by == "run"
        assert "labrig run b.yaml" in report.done[0]
        assert abs(moving.read_states()["insertion"].speed) < 0.01
    assert not socket.exists()


def test_a_labrig_that_hangs_answers_nobody(tmp_path: Path) -> None:
    """It is given a second; then the rig is stopped otherwise, and that is said."""
    rig = _kept(tmp_path)
    with open_rig(rig, seed=1, person=Person(), interrupted=Signal(), doing="labrig run c.yaml"):
        reply = ask_to_stop(rig)
        assert reply is not None
        assert reply.failures is None
        report = stop_rig(rig)
    assert report.by == "none"
    assert "labrig run c.yaml" in report.done[0]
    assert "did not answer" in report.done[0]


def test_whoever_calls_and_says_nothing_is_no_reason_to_stop(tmp_path: Path) -> None:
    """Noise on the socket does not end a run."""
    rig = _kept(tmp_path)
    with open_rig(rig, seed=1, person=Person(), interrupted=Signal()) as open_one:
        for said in (None, "hello"):
            caller = call(tmp_path / "state.json.socket")
            assert caller is not None
            if said is not None:
                caller.say(said)
            open_one.wait(0.1)
            caller.close()
        open_one.wait(0.1)


def test_a_socket_left_by_a_killed_labrig_is_nobody(tmp_path: Path) -> None:
    """Nobody listens behind it: the rig is stopped over the bus."""
    (tmp_path / "state.json.socket").touch()
    assert ask_to_stop(_kept(tmp_path)) is None
