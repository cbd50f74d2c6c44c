"""Rig files that are refused, with line and hint, before any frame is sent on the bus."""

from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from labrig.devices.rig import open_rig
from labrig.devices.rig_file import load_rig
from labrig.errors import DriveError, FileFormatError, InputError
from labrig.protocol.yaml_file import dump_yaml
from tests.devices.bench_rig import bench_description, bench_rig
from tests.devices.rigs import Person, Signal

CHANNEL = "bad-rig-files"


@pytest.fixture(name="bus")
def _bus() -> Iterator[can.BusABC]:
    bus = can.Bus(interface="virtual", channel=CHANNEL)
    yield bus
    bus.shutdown()


def _frames(bus: can.BusABC) -> int:
    """Return how many frames have passed."""
    count = 0
    while bus.recv(0.0) is not None:
        count += 1
    return count


def _write(folder: Path, old: str, new: str) -> Path:
    """Write a bench's rig file on that bus, complete, with a stretch replaced where it stands first."""
    text = dump_yaml(bench_description({"interface": "virtual", "channel": CHANNEL}))
    assert old in text, text
    path = folder / "rig.yaml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    return path


def _lines_with(path: Path, stretch: str) -> list[int]:
    """Return the numbers of the lines that hold a line of a stretch."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return [n for n, line in enumerate(lines, 1) if any(part in line for part in stretch.splitlines())]


def _open(path: Path) -> None:
    with bench_rig(load_rig(path), path.parent):
        pytest.fail("a rig without drives has opened")


def test_a_valid_rig_file_sends_frames(bus: can.BusABC, tmp_path: Path) -> None:
    """The counting bus works: a valid rig without drives is refused only after frames have been sent."""
    with pytest.raises(DriveError, match=r"node 1.*did not answer.*node 2.*did not answer.*node 3"):
        _open(_write(tmp_path, "node_id: 1", "node_id: 1"))
    assert _frames(bus) >= 6


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("gear_ratio: 4.0", "gear_ratio: null", r"axes\.insertion\.gear_ratio"),
        ("max_speed: 5.0", "max_speed: 500", r"\(0x607F:00\) would be 60000, the drive takes 0 to 25000"),
        ("    - 120.0", "    - 1e9", r"\(0x607A:00\) would be 4000000000000, the drive takes"),
    ],
)
def test_a_rig_file_that_no_drive_takes_sends_no_frame(
    bus: can.BusABC, tmp_path: Path, old: str, new: str, words: str
) -> None:
    """The entries that are still missing are named, and the objects that cannot have such values."""
    path = _write(tmp_path, old, new)
    with (
        pytest.raises(InputError, match=words),
        open_rig(load_rig(path), seed=1, person=Person(), interrupted=Signal()),
    ):
        pass
    assert _frames(bus) == 0


BAD = [
    ("gear_ratio: 4.0", "gear_ratio: 0", "greater than 0"),
    ("gear_ratio: 4.0", "gear_ratio: -4", "greater than 0"),
    ("gear_ratio: 4.0", "gear_ratio: 1e9", "10000"),
    ("gear_ratio: 4.0", "gear_ratio: .nan", "gear_ratio"),
    ("gear_ratio: 4.0", "gear_ratio: four", "gear_ratio"),
    ("lead_mm: 2.0", "lead_mm: 0", "greater than 0"),
    ("encoder_pulses_per_turn: 500", "encoder_pulses_per_turn: 0", "16"),
    ("encoder_pulses_per_turn: 500", "encoder_pulses_per_turn: 2500001", "2500000"),
    ("node_id: 2", "node_id: 1", "also that of axis insertion"),
    ("\n    node_id: 1\n", "\n    node_id: 0\n", "node_id is 0"),
    ("\n    node_id: 1\n", "\n    node_id: 128\n", "node_id is 128"),
    ("\n    node_id: 1\n", "\n    node_id: 127\n", "under which the computer beats"),
    ("timeout_ms: 500", "timeout_ms: 150", "three periods"),
    ("interface: virtual", "interface: sockercan", "socketcan, socketcand"),
    ("bitrate: 1000000", "bitrate: 1234567", "bitrate"),
    ("bitrate: 1000000", "bitrate: 1 Mbit/s", "bitrate"),
    ("acceleration: 50.0", "acceleration: 0", "greater than 0"),
    ("acceleration: 50.0", "acceleraton: 50", "did you mean acceleration"),
    ("limits:\n    - -2.0\n    - 120.0", "limits:\n    - 120.0\n    - -2.0", "expected the lower one first"),
    ("limits:\n    - -2.0\n    - 120.0", "limits:\n    - -2.0", "limits"),
    ("unit: rad", "unit: deg", "unit"),
]


@pytest.mark.parametrize(("old", "new", "words"), BAD)
def test_an_invalid_rig_file_is_refused_before_any_frame(
    bus: can.BusABC, tmp_path: Path, old: str, new: str, words: str
) -> None:
    """Each problem has file, line and what to write instead, and nothing was sent."""
    path = _write(tmp_path, old, new)
    with pytest.raises(FileFormatError) as refusal:
        _open(path)
    assert _frames(bus) == 0
    lines = [f"{path}:{number}:" for number in _lines_with(path, new)]
    problems = [p for p in refusal.value.problems if words in f"{p.message} {p.hint}"]
    assert [p for p in problems if p.where.startswith(tuple(lines))], refusal.value.problems
    assert all(p.hint for p in problems)
