"""Only one labrig uses a rig, and another one can stop it."""

import os
import socket
import stat
import subprocess
import sys
import tempfile
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from labrig.devices.check import check_rig
from labrig.devices.control import acquire_rig, ask_to_stop, find_lock_paths, find_owner
from labrig.devices.needle_state import NeedleState
from labrig.devices.rig import Rig, open_rig
from labrig.devices.rig_file import RigDescription, load_rig
from labrig.devices.stop import stop_rig
from labrig.errors import DiskError, LockedError, OutputExistsError, SafetyStopError
from labrig.posix import connect, identify_user
from tests.devices.rigs import BENCH, Person, Signal, simulated_rig


def _make_rig(tmp_path: Path) -> RigDescription:
    return simulated_rig("state_file=state.json").placed_in(tmp_path)


def _wait_for(asked: Future[Any], rig: Rig) -> None:
    while not asked.done():
        rig.wait(0.1)


def test_only_one_labrig_uses_a_rig_at_a_time(tmp_path: Path) -> None:
    """A second one is refused with the name of the first; the rig is free when that ends."""
    rig = _make_rig(tmp_path)
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
    """A process that was killed with the rig open does not keep others out."""
    code = (
        "import os,sys;from pathlib import Path;from labrig.record.lock import FileLock\n"
        f"FileLock(Path({str(find_lock_paths(_make_rig(tmp_path))[0])!r})).acquire('labrig run dead.yaml');os._exit(9)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 9
    with open_rig(_make_rig(tmp_path), seed=1, person=Person(), interrupted=Signal()):
        pass


def test_rig_files_with_the_same_bus_exclude_each_other(tmp_path: Path) -> None:
    """Locks cover the bus as well as the state file, whatever the nodes; another channel is another bus."""
    first, second = load_rig(BENCH), load_rig(BENCH, ["state_file=other.json"])
    others = [
        f"axes.{name}.node_id={n}" for n, name in enumerate(("insertion", "rotation", "linear"), start=11)
    ]
    third = load_rig(BENCH, ["state_file=third.json", "can.options.receive_own_messages=false", *others])
    elsewhere = load_rig(BENCH, ["state_file=other.json", "can.channel=can1"])
    assert len(set(find_lock_paths(first)) & set(find_lock_paths(second)) & set(find_lock_paths(third))) == 1
    assert not set(find_lock_paths(first)) & set(find_lock_paths(elsewhere))
    assert find_lock_paths(simulated_rig()) == ()


def test_a_link_to_a_serial_port_is_the_same_bus(tmp_path: Path) -> None:
    """An adapter by its id and by its number is one bus."""
    (tmp_path / "ttyACM0").touch()
    (tmp_path / "by-id").symlink_to(tmp_path / "ttyACM0")
    found = [
        find_lock_paths(load_rig(BENCH, ["can.interface=slcan", f"can.channel={tmp_path / name}"]))[-1]
        for name in ("ttyACM0", "by-id")
    ]
    assert found[0] == found[1]


_HOLD_BUS = """
import os, sys
from pathlib import Path
from labrig.devices.control import acquire_rig
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
    """A labrig of another account, with other locks, keeps the bus to itself until it has ended."""
    rig = load_rig(BENCH).placed_in(tmp_path)
    with (
        tempfile.TemporaryDirectory() as theirs,
        subprocess.Popen(
            [sys.executable, "-c", _HOLD_BUS, str(BENCH), theirs],
            env={**os.environ, "XDG_RUNTIME_DIR": theirs},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        ) as other,
    ):
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        assert f"process {other.pid}" in find_owner(rig)
        with (
            pytest.raises(
                LockedError, match=rf"the CAN bus .* is in use by another labrig \(process {other.pid}"
            ),
            acquire_rig(rig, "labrig run mine.yaml"),
        ):
            pass
        assert other.stdin is not None
        other.stdin.close()
        other.wait()
    with acquire_rig(rig, "labrig run mine.yaml"):
        assert find_owner(rig).startswith("labrig run mine.yaml")


@pytest.mark.parametrize("depth", [1, 12])
def test_a_moving_rig_is_stopped_by_another_labrig(tmp_path: Path, depth: int) -> None:
    """The moving one stops, reports that every axis stands still, and its wait raises."""
    folder = tmp_path.joinpath(*["folder with a long name"] * depth)
    folder.mkdir(parents=True)
    rig = _make_rig(folder)
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
    """It gets a second to answer; then the rig is stopped over the bus, and the report says so."""
    rig = _make_rig(tmp_path)
    with open_rig(rig, seed=1, person=Person(), interrupted=Signal(), doing="labrig run c.yaml"):
        reply = ask_to_stop(rig)
        assert reply is not None
        assert reply.failures is None
        report = stop_rig(rig)
    assert report.by == "none"
    assert "labrig run c.yaml" in report.done[0]
    assert "did not answer" in report.done[0]


def test_a_caller_without_a_request_does_not_stop_a_run(tmp_path: Path) -> None:
    """Silence or noise on the socket does not end a run."""
    rig = _make_rig(tmp_path)
    with open_rig(rig, seed=1, person=Person(), interrupted=Signal()) as open_one:
        for line in (None, "hello"):
            caller = connect(tmp_path / "state.json.socket")
            assert caller is not None
            if line is not None:
                caller.send(line)
            open_one.wait(0.1)
            caller.close()
        open_one.wait(0.1)


def test_a_flood_on_the_socket_holds_nobody_up(tmp_path: Path) -> None:
    """A caller that sends without end is hung up on within one reading of a bounded line, and others are heard."""
    rig = _make_rig(tmp_path)
    with open_rig(rig, seed=1, person=Person(), interrupted=Signal()) as opened:
        flood = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        flood.connect(str(tmp_path / "state.json.socket"))
        with ThreadPoolExecutor(2) as pool:
            sent = pool.submit(flood.sendall, bytes(50_000_000))
            _wait_for(sent, opened)
            assert isinstance(sent.exception(), ConnectionError)
            asked = pool.submit(ask_to_stop, rig)
            with pytest.raises(SafetyStopError, match="stopped by labrig devices stop"):
                _wait_for(asked, opened)
        flood.close()


def test_more_callers_than_are_heard_keep_nobody_out(tmp_path: Path) -> None:
    """Of many callers that say nothing the oldest are hung up on, and the request of the last is heard."""
    rig = _make_rig(tmp_path)
    with open_rig(rig, seed=1, person=Person(), interrupted=Signal()) as opened:
        silent = []
        for _ in range(20):
            silent.append(connect(tmp_path / "state.json.socket"))
            opened.wait(0.1)
        with ThreadPoolExecutor(1) as pool:
            asked = pool.submit(ask_to_stop, rig)
            with pytest.raises(SafetyStopError, match="stopped by labrig devices stop"):
                _wait_for(asked, opened)
        for caller in silent:
            assert caller is not None
            caller.close()


def test_a_file_in_the_place_of_the_socket_is_kept(tmp_path: Path) -> None:
    """A file that is no socket is not removed for it, and the rig is not opened."""
    (tmp_path / "state.json.socket").write_text("mine")
    with (
        pytest.raises(DiskError, match="cannot listen at"),
        open_rig(_make_rig(tmp_path), seed=1, person=Person(), interrupted=Signal()),
    ):
        pass
    assert (tmp_path / "state.json.socket").read_text() == "mine"


@pytest.mark.parametrize("content", ["Notes of today.\n", '{"kind": "labrig-plane"}', "{"])
def test_a_state_file_never_replaces_a_file_of_something_else(tmp_path: Path, content: str) -> None:
    """A rig whose state_file names notes is not opened, devices check fails, and the notes are as they were."""
    (tmp_path / "state.json").write_text(content)
    with (
        pytest.raises(OutputExistsError, match=r"state\.json is named as the state file") as refused,
        open_rig(_make_rig(tmp_path), seed=1, person=Person(), interrupted=Signal()),
    ):
        pass
    assert "state_file:" in refused.value.hint
    assert (tmp_path / "state.json").read_text() == content
    found = {result.check: result for result in check_rig(_make_rig(tmp_path))}
    assert found["rig state"].status == "FAIL"


@pytest.mark.parametrize("content", ["", '{"kind": "labrig-rig-state", "schema_version": 1'])
def test_an_empty_or_torn_state_file_is_replaced(tmp_path: Path, content: str) -> None:
    """A file that labrig wrote, or an empty one, is replaced by the first change."""
    (tmp_path / "state.json").write_text(content)
    with open_rig(_make_rig(tmp_path), seed=1, person=Person(), interrupted=Signal()) as opened:
        assert opened.state.needle_in_tissue is None
        opened.needle.mark_out()
    assert NeedleState(tmp_path / "state.json").state.needle_in_tissue is False


@pytest.fixture
def lock_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return where the locks of drives are, not made yet."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path / "labrig"


def _acquire_drives(folder: Path) -> None:
    with acquire_rig(load_rig(BENCH).placed_in(folder), "labrig run"):
        pass


def test_locks_are_kept_in_a_folder_of_this_account_alone(lock_folder: Path, tmp_path: Path) -> None:
    """The folder is made with mode 700, and taken again."""
    for _ in range(2):
        _acquire_drives(tmp_path)
        assert stat.S_IMODE(lock_folder.stat().st_mode) == 0o700


def test_a_planted_lock_folder_is_refused(lock_folder: Path, tmp_path: Path) -> None:
    """A link, a file, and a folder that others can use are named; whoever has the rig is still looked up."""
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    lock_folder.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(DiskError, match="labrig is a link, not a folder"):
        _acquire_drives(tmp_path)
    lock_folder.unlink()
    lock_folder.touch()
    with pytest.raises(DiskError, match=r"cannot make .*labrig: File exists"):
        _acquire_drives(tmp_path)
    lock_folder.unlink()
    lock_folder.mkdir()
    lock_folder.chmod(0o770)
    with pytest.raises(DiskError, match="its mode is 770, not 700"):
        _acquire_drives(tmp_path)
    assert find_owner(load_rig(BENCH).placed_in(tmp_path)) == ""


@pytest.mark.skipif(identify_user() != "0", reason="only root can give a folder away")
def test_a_lock_folder_of_another_account_is_refused(lock_folder: Path, tmp_path: Path) -> None:
    """Its owner is named."""
    lock_folder.mkdir(mode=0o700)
    os.chown(lock_folder, 12345, -1)
    with pytest.raises(DiskError, match="belongs to account 12345, not to 0"):
        _acquire_drives(tmp_path)


def test_a_socket_of_a_killed_labrig_is_ignored(tmp_path: Path) -> None:
    """Nobody listens at it, so the rig is stopped over the bus."""
    (tmp_path / "state.json.socket").touch()
    assert ask_to_stop(_make_rig(tmp_path)) is None
