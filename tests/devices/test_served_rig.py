"""A rig served for a rehearsal: which rig files can be, and the world that its camera sees."""

import socket
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from queue import SimpleQueue
from threading import Event

import numpy as np
import pytest

from labrig.devices.camera import Picture
from labrig.devices.fault_script import FaultDescription
from labrig.devices.rig_file import load_rig
from labrig.devices.simulated.local_ports import LocalPorts, find_local_ports
from labrig.devices.simulated.picture_stream import PictureStream
from labrig.devices.simulated.served_rig import Rehearsal, SeenWorld, serve_rig
from labrig.errors import InputError
from labrig.simulation.world import World
from tests.devices.rigs import BENCH, SIMULATED
from tests.rehearsing import copy_rig

REHEARSAL = BENCH.parent / "rig-rehearsal.yaml"
_LONG_S = 60.0
FILES = (
    "camera={driver: files, source: 'http://127.0.0.1:29537/', width_px: 1280, height_px: 720, rate_hz: 10}"
)
"""Recorded pictures: no camera of a bench."""


def test_the_example_names_two_ports_of_this_computer() -> None:
    """They are those of bus and camera."""
    assert find_local_ports(load_rig(REHEARSAL)) == LocalPorts(can=29536, camera=29537)


def test_the_example_has_the_drives_and_the_calibration_of_the_simulated_rig() -> None:
    """Its travel and its homing are those of a bench."""
    rehearsal, simulated = load_rig(REHEARSAL), load_rig(SIMULATED)
    for (name, axis), (_, other) in zip(rehearsal.axes.items(), simulated.axes.items(), strict=True):
        assert axis.model_copy(update={"homing": other.homing, "limits": other.limits}) == other, name
    assert rehearsal.calibration == simulated.calibration


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (("can.interface=socketcan", "can.channel=can0"), "can is socketcan can0"),
        (("can.channel=/dev/ttyACM0",), "can is slcan /dev/ttyACM0"),
        (("can.channel='socket://10.0.0.5:29536'",), "can is slcan socket://10.0.0.5:29536"),
        (("can.channel='socket://127.0.0.1:port'",), "can is slcan socket://127.0.0.1:port"),
        (("can.channel='socket://127.0.0.1'",), "can is slcan socket://127.0.0.1"),
        (("can.channel='socket://127.0.0.1:0'",), "can is slcan socket://127.0.0.1:0"),
        (("camera.source='http://10.0.0.7/live'",), "camera is mjpeg http://10.0.0.7/live"),
        (("camera.source='https://127.0.0.1:29537/'",), "camera is mjpeg https://"),
        ((FILES,), "camera is files http://127.0.0.1:29537/"),
    ],
)
def test_a_rig_elsewhere_is_not_served(overrides: tuple[str, ...], words: str) -> None:
    """Simulated drives never join a bus that may have real ones; the hint says what to write."""
    with pytest.raises(InputError, match=words) as refusal:
        find_local_ports(load_rig(REHEARSAL, overrides))
    assert "socket://127.0.0.1:29536" in refusal.value.hint
    assert "http://127.0.0.1:29537/" in refusal.value.hint


def test_the_hint_for_a_bench_is_a_rig_file_that_is_served(tmp_path: Path) -> None:
    """Its two sections, put into the file of the bench, name ports."""
    with pytest.raises(
        InputError, match="rig bench is not served: can is socketcan can0, camera is uvc"
    ) as refusal:
        find_local_ports(load_rig(BENCH))
    can, camera = (refusal.value.hint.split(f" {key}: ")[1].split("}, ")[0] for key in ("can", "camera"))
    braces = can.count("{") - can.count("}")
    sections = (f"can={can}{'}' * braces}", f"camera={camera.split('} ')[0]}}}")
    assert find_local_ports(load_rig(BENCH, sections)) == LocalPorts(can=29536, camera=29537)


def test_bus_and_camera_cannot_share_a_port() -> None:
    """The error names it."""
    with pytest.raises(InputError, match="the same port, 29536"):
        find_local_ports(load_rig(REHEARSAL, ["camera.source='http://127.0.0.1:29536/'"]))


def test_a_camera_of_another_size_than_the_worlds_is_refused() -> None:
    """The error names both sizes."""
    rig, world = load_rig(REHEARSAL, ["camera.width_px=640"]), load_rig(SIMULATED).world
    with pytest.raises(InputError, match=r"640x720 px, the world's lens draws 1280x720 px"):
        serve_rig(
            Rehearsal(rig, world),
            until=lambda: True,
            ready=lambda: None,
            typed=list,
            report=lambda _line: None,
        )


def test_an_unplugged_adapter_ends_its_connections(tmp_path: Path) -> None:
    """The fault of the script does what pulling the plug of a serial adapter does: a program reads the end."""
    rig, ends = load_rig(copy_rig(tmp_path)), Event()
    faults = (FaultDescription(fault="unplugged"),)
    with ThreadPoolExecutor(1) as server:
        ready = Event()
        serving = server.submit(
            serve_rig,
            Rehearsal(rig, load_rig(SIMULATED).world, faults=faults),
            until=ends.is_set,
            ready=ready.set,
            typed=list,
            report=lambda _line: None,
        )
        try:
            assert ready.wait(_LONG_S)
            with socket.create_connection(("127.0.0.1", find_local_ports(rig).can), _LONG_S) as program:
                assert program.recv(1) == b""
        finally:
            ends.set()
            serving.result(_LONG_S)


class _Screen(PictureStream):
    """Keeps the pictures that it is shown."""

    def __init__(self) -> None:
        self.shown: SimpleQueue[tuple[Picture, float]] = SimpleQueue()

    @property
    def has_clients(self) -> bool:
        """Somebody looks."""
        return True

    def show(self, picture: Picture, exposed_utc_s: float) -> None:
        """Keep it."""
        self.shown.put((picture, exposed_utc_s))


class _Clock:
    """Time that passes when a test says so; its day began at 1000 s since 1970."""

    def __init__(self) -> None:
        self.time_s = 0.0

    def now_s(self) -> float:
        """Return it."""
        return self.time_s

    def sleep(self, duration_s: float) -> None:
        """Let it pass."""
        self.time_s += duration_s

    def suspended_s(self) -> float:
        """Return 0."""
        return 0.0

    def utc(self) -> datetime:
        """Return the date of it."""
        return datetime.fromtimestamp(1000 + self.time_s, UTC)


@contextmanager
def _seen_world() -> Iterator[tuple[SeenWorld, _Screen, _Clock, "SimpleQueue[str]"]]:
    screen, clock, reports = _Screen(), _Clock(), SimpleQueue[str]()
    world = World(load_rig(SIMULATED).world, 1)
    with closing(SeenWorld(world, screen, clock, rate_hz=20.0, report=reports.put)) as seen:
        yield seen, screen, clock, reports


def test_the_camera_sees_what_the_drives_move() -> None:
    """A needle that the shafts bring into a gel darkens the picture along its path, at the time of its positions."""
    with _seen_world() as (seen, screen, clock, reports):
        for line in ("needle N1", "specimen gel 13", "hole 1 0"):
            seen.do(line)
            assert reports.get(timeout=_LONG_S) == f"done: {line}"
        before = _move_to(0.0, seen, screen, clock)
        for depth_mm in range(1, 30):
            _move(float(depth_mm), seen, clock)
        after = _move_to(30.0, seen, screen, clock)
    rows, columns = np.nonzero(np.abs(after.astype(int) - before) > 40)
    assert 500 < len(rows) < 20_000
    assert columns.min() >= 150  # where the sheath ends
    assert rows.max() > rows.min() + 20  # the needle bends


def _move(insertion_mm: float, seen: SeenWorld, clock: _Clock) -> None:
    clock.sleep(0.5)
    seen.move(clock.utc().timestamp(), {"insertion": insertion_mm, "rotation": 0.0, "linear": 15.0})


def _move_to(insertion_mm: float, seen: SeenWorld, screen: _Screen, clock: _Clock) -> Picture:
    """Return the picture whose time is that at which the axes stood at a position; it is drawn later."""
    _move(insertion_mm, seen, clock)
    moved_utc_s = clock.utc().timestamp()
    for _ in range(100):
        clock.sleep(0.1)
        picture, exposed_utc_s = screen.shown.get(timeout=_LONG_S)
        if exposed_utc_s == moved_utc_s:
            return picture
    raise AssertionError("no picture of this time")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("hole 1 0", "not done: no specimen is on the bench (place one first: specimen NAME PERCENT)"),
        ("specimen gel 50", "not done: "),
        ("nonsense", "not done: 'nonsense' is not understood"),
    ],
)
def test_what_cannot_be_done_is_said_and_the_world_goes_on(line: str, words: str) -> None:
    """The next line is done."""
    with _seen_world() as (seen, _, _, reports):
        seen.do(line)
        assert reports.get(timeout=_LONG_S).startswith(words)
        seen.do("needle N2")
        assert reports.get(timeout=_LONG_S) == "done: needle N2"
        seen.check()


def test_a_bug_in_the_worlds_thread_is_raised_where_the_rig_is_served() -> None:
    """It does not end the thread in silence."""
    with _seen_world() as (seen, _, _, _):
        seen.move(0.0, {"insertion": 1.0})
        seen._life.exception(timeout=_LONG_S)
        with pytest.raises(KeyError):
            seen.check()
