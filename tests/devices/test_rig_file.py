"""Rig files: their content, and refusals with a line."""

from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from labrig.devices.rig import open_rig
from labrig.devices.rig_file import (
    find_problems,
    load_rig,
    require_complete,
    rig_schema,
)
from labrig.errors import DriveError, FileFormatError, InputError
from labrig.protocol.schema import schema_text
from labrig.protocol.sections import Needle, NeedleDesignSection
from labrig.protocol.yaml_file import dump_yaml
from labrig.simulation.description import DesignDescription
from tests.devices.bench_rig import bench_description, bench_rig
from tests.devices.rigs import BENCH, CALIBRATION, SIMULATED, Person, Signal, large_rig, rig_text


def test_the_committed_schema_is_current() -> None:
    """calibration/rig.schema.json is that of the models; labrig init writes it."""
    assert (CALIBRATION / "rig.schema.json").read_text(encoding="utf-8") == schema_text(rig_schema())


def test_the_simulated_rig_makes_the_papers_speeds_exactly() -> None:
    """1 and 5 mm/s of insertion and sheath are integer rpm."""
    rig = load_rig(SIMULATED)
    for axis in (rig.axes.insertion, rig.axes.linear):
        for speed in (1.0, 5.0):
            assert axis.scale().to_speed(axis.scale().to_speed_units(speed)) == speed


def test_an_unknown_driver_is_named_with_those_that_are_installed(tmp_path: Path) -> None:
    """The error has its line and the nearest name."""
    path = tmp_path / "rig.yaml"
    path.write_text(rig_text({"  rotation:\n": "  rotation:\n    driver: epos3\n"}), encoding="utf-8")
    with pytest.raises(FileFormatError) as refusal:
        load_rig(path)
    (problem,) = refusal.value.problems
    assert problem.where.startswith(f"{path}:")
    assert problem.where.endswith("axes.rotation.driver")
    assert problem.message.startswith('driver is "epos3", must be one of ')
    assert problem.hint == "did you mean epos2?"
    assert refusal.value.exit_code == 2


def test_the_bench_says_what_is_unknown_and_where_to_find_it() -> None:
    """Encoder, gear and lead of linear axes; a rotating axis has no lead."""
    unknown = {problem.where: problem.hint for problem in find_problems(load_rig(BENCH))}
    assert len(unknown) == 8
    assert "axes.rotation.lead_mm" not in unknown
    assert "data sheet" in unknown["axes.linear.lead_mm"]
    with pytest.raises(InputError, match=r"axes\.linear\.lead_mm"):
        require_complete(load_rig(BENCH), ("linear",))


def _designed_needle(diameter_mm: float = 1.4) -> Needle:
    return Needle(
        needle_id="N2",
        diameter_mm=diameter_mm,
        design_radius_mm=45.0,
        design=NeedleDesignSection(
            file="n2.json",
            sha256="0" * 64,
            radius_low_mm=42.5,
            radius_high_mm=48.0,
            link_length_mm=3.5,
        ),
    )


def test_the_simulated_world_has_the_designed_needle_in_it() -> None:
    """Diameter, links and radius tolerance come from the design; its files stay in place."""
    plain = large_rig()
    rig = plain.with_needle(_designed_needle())
    assert rig.world is not None
    needle = rig.world.needle
    assert (needle.diameter_mm, needle.link_mm) == (1.4, 3.5)
    assert needle.design == DesignDescription(radius_low_mm=42.5, radius_high_mm=48.0)
    assert rig.calibration_paths() == plain.calibration_paths()


def test_a_needle_wider_than_the_simulated_sheath_is_refused() -> None:
    """The error has both diameters."""
    with pytest.raises(FileFormatError, match=r"2\.2 mm; must be below sheath.diameter_mm, 2 mm"):
        large_rig().with_needle(_designed_needle(2.2))


def test_a_lens_that_draws_pictures_of_another_size_is_refused() -> None:
    """The world's lens gives what the camera is set to."""
    with pytest.raises(FileFormatError, match="is set to 640x720 px, the world's lens draws 1280x720 px"):
        large_rig("camera.width_px=640")


@pytest.mark.parametrize("echoing", ["can.interface=udp_multicast", "can.options.receive_own_messages=true"])
def test_a_bus_that_echoes_is_refused(echoing: str) -> None:
    """What labrig sends would come back to it as another master's."""
    with pytest.raises(FileFormatError, match="take itself for another master"):
        load_rig(CALIBRATION / "rig-bench.yaml", [echoing])


# Refused before any frame


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
    ("counts_per_turn: 2000", "counts_per_turn: 0", "greater than 0"),
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
    ("limits:\n    - -2.0\n    - 120.0", "limits:\n    - 120.0\n    - -2.0", "must have the lower one first"),
    ("limits:\n    - -2.0\n    - 120.0", "limits:\n    - -2.0", "limits"),
    ("unit: rad", "unit: deg", "unit"),
    ("unit: rad", "unit: mm", "expected rad"),
    ("interface: virtual", "interface: simulated", "does not go with kind bench"),
    ("state_file: bench.state.json", "state_file: null", "a bench needs a state_file"),
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
