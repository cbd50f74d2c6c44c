"""Rig files: their content, and refusals with a line."""

from pathlib import Path

import can
import pytest

from labrig.devices.opening import Opening
from labrig.devices.rig import open_rig
from labrig.devices.rig_file import find_problems, load_rig, require_complete, rig_schema
from labrig.errors import DriveError, FileFormatError, InputError
from labrig.protocol.schema import schema_text
from labrig.protocol.sections import Needle, NeedleDesignSection
from labrig.simulation.description import DesignDescription
from tests.devices.rigs import BENCH, CALIBRATION, SIMULATED, Person, Signal, large_rig, rig_text
from tests.devices.served import bench_description


def test_the_committed_schema_is_current() -> None:
    """calibration/rig.schema.json is that of the models; labrig init writes it."""
    assert (CALIBRATION / "rig.schema.json").read_text(encoding="utf-8") == schema_text(rig_schema())


def test_the_simulated_rig_makes_the_papers_speeds_exactly() -> None:
    """1 and 5 mm/s of insertion and sheath are integer rpm."""
    rig = load_rig(SIMULATED)
    for axis in (rig.axes.insertion, rig.axes.linear):
        for speed in (1.0, 5.0):
            assert axis.scale().to_speed(axis.scale().to_speed_units(speed)) == speed


def test_a_problem_has_its_line_and_the_nearest_name(tmp_path: Path) -> None:
    """File, line, key, and what to write instead."""
    path = tmp_path / "rig.yaml"
    path.write_text(rig_text("    node_id: 2\n", "    node_id: 2\n    driver: epos3\n"), encoding="utf-8")
    line = 1 + path.read_text(encoding="utf-8").partition("    driver: epos3")[0].count("\n")
    with pytest.raises(FileFormatError) as refusal:
        load_rig(path)
    (problem,) = refusal.value.problems
    assert problem.where.startswith(f"{path}:{line}:")
    assert problem.where.endswith("axes.rotation.driver")
    assert problem.message.startswith('driver is "epos3", must be one of ')
    assert problem.hint == "did you mean epos2?"
    assert refusal.value.exit_code == 2


DRIVES = Opening(camera=False)
FORCE = "unit: N, source: analog-1"
REFUSED = {
    BENCH: [
        ("axes.insertion.gear_ratio=0", "greater than 0"),
        ("axes.insertion.gear_ratio=10000", ""),
        ("axes.insertion.gear_ratio=10001", "10000"),
        ("axes.insertion.gear_ratio=.nan", "gear_ratio"),
        ("axes.insertion.gear_ratio=four", "gear_ratio"),
        ("axes.insertion.lead_mm=0", "greater than 0"),
        ("axes.insertion.acceleraton=50", "did you mean acceleration"),
        ("axes.insertion.limits=[120, -2]", "must have the lower one first"),
        ("axes.insertion.limits=[-2]", "limits"),
        ("axes.insertion.unit=deg", "unit"),
        ("axes.rotation.unit=mm", "expected rad"),
        ("axes.rotation.node_id=1", "also that of axis insertion"),
        ("axes.rotation.node_id=0", "node_id is 0"),
        ("axes.rotation.node_id=126", ""),
        ("axes.rotation.node_id=127", "under which the computer beats"),
        ("can.heartbeat.timeout_ms=300", ""),
        ("can.heartbeat.timeout_ms=299", "three periods"),
        ("can.interface=sockercan", "socketcan, socketcand"),
        ("can.interface=simulated", "does not go with kind bench"),
        ("can.bitrate=1234567", "bitrate"),
        ("state_file=null", "a bench needs a state_file"),
        ("faults=[{fault: unplugged}]", "has no section faults"),
    ],
    SIMULATED: [
        ("camera.width_px=640", "is set to 640x720 px, the world's lens draws 1280x720 px"),
        ("faults=[{fault: silent}]", "needs an axis"),
        ("faults=[{fault: bus-off, axis: linear}]", "has no axis"),
        ("faults=[{fault: emergency, axis: linear}]", "needs a code"),
        ("faults=[{fault: boot-up, axis: linear, code: 1}]", "has no code"),
        ("faults=[{fault: unplugged, once: moving}]", "waits for no axis"),
        ("faults=[{fault: input, axis: linear}]", "needs a source"),
        ("faults=[{fault: blocked, axis: linear, source: analog-1}]", "has no source"),
        ("faults=[{fault: gremlins}]", "gremlins"),
        (f"axes.linear.inputs={{force: {{{FORCE}}}}}", "units_per_volt is missing or zero for analog-1"),
        ("axes.linear.inputs={force: {source: analog-1, units_per_volt: 4}}", "unit is missing or zero"),
        ("axes.linear.inputs={door: {source: general-A, limits: [0, 1]}}", "general-A is a digital input"),
        (f"axes.linear.inputs={{force: {{{FORCE}, units_per_volt: 4, expected: true}}}}", "an analog input"),
        ("axes.linear.inputs={force: {unit: N, units_per_volt: 4, source: analog-9}}", "analog-9 is no input"),
        ("axes.linear.inputs={Door: {source: general-A}}", "Door"),
        ("axes.linear.inputs={shut: {source: general-A}}", "input shut is also one of axis insertion"),
    ],
}  # fmt: skip


@pytest.mark.parametrize(
    ("file", "override", "words"), [(file, *row) for file, rows in REFUSED.items() for row in rows]
)
def test_an_impossible_rig_is_refused(file: Path, override: str, words: str) -> None:
    """What is just possible (no words) is taken; else the problem says what it should be.

    Two axes share no name of an input, by which records tell channels apart.
    """
    problems = []
    try:
        load_rig(file, ("axes.insertion.inputs={shut: {source: general-A}}", override))
    except FileFormatError as refusal:
        problems = [f"{problem.message} {problem.hint}" for problem in refusal.problems]
    assert any(words in problem for problem in problems) if words else problems == []


@pytest.mark.parametrize("echoing", ["can.interface=udp_multicast", "can.options.receive_own_messages=true"])
def test_a_bus_that_echoes_is_refused(echoing: str) -> None:
    """What labrig sends would come back to it as another master's."""
    with pytest.raises(FileFormatError, match="take itself for another master"):
        load_rig(BENCH, (echoing,))


def test_the_bench_says_what_is_unknown_and_where_to_find_it() -> None:
    """Encoder, gear and lead of linear axes; a rotating axis has no lead."""
    unknown = {problem.where: problem.hint for problem in find_problems(load_rig(BENCH))}
    assert len(unknown) == 8
    assert "axes.rotation.lead_mm" not in unknown
    assert "data sheet" in unknown["axes.linear.lead_mm"]
    with pytest.raises(InputError, match=r"axes\.linear\.lead_mm"):
        require_complete(load_rig(BENCH), ("linear",))


@pytest.mark.parametrize(
    ("override", "refused", "words"),
    [
        ("axes.insertion.gear_ratio=null", InputError, r"axes\.insertion\.gear_ratio"),
        ("axes.insertion.max_speed=500", InputError, r"\(0x607F:00\) would be 60000, the drive takes 0 to 25000"),
        ("axes.insertion.limits=[-2, 1e9]", InputError, r"\(0x607A:00\) would be 4000000000000, the drive takes"),
        ("name=valid", DriveError, r"node 1.*did not answer.*node 2.*did not answer.*node 3"),
    ],
)  # fmt: skip
def test_a_rig_file_that_no_drive_takes_sends_no_frame(
    tmp_path: Path, override: str, refused: type[Exception], words: str
) -> None:
    """Missing entries are named, and objects that cannot have such values; a valid one sends some."""
    channel = "bad-rig-files"
    at = {"interface": "virtual", "channel": channel}
    description = bench_description(at, override).placed_in(tmp_path)
    with can.Bus(interface="virtual", channel=channel) as bus:
        with (
            pytest.raises(refused, match=words),
            open_rig(description, seed=1, person=Person(), interrupted=Signal(), opening=DRIVES),
        ):
            pass
        assert (bus.recv(0.0) is None) is (refused is InputError)


def _designed_needle(diameter_mm: float = 1.4) -> Needle:
    design = {"radius_low_mm": 42.5, "radius_high_mm": 48.0, "link_length_mm": 3.5}
    section = NeedleDesignSection(file="n2.json", sha256="0" * 64, **design)
    return Needle(needle_id="N2", diameter_mm=diameter_mm, design_radius_mm=45.0, design=section)


def test_the_simulated_world_has_the_designed_needle_in_it() -> None:
    """Diameter, links and radius tolerance come from the design, its files stay in place; one too wide is refused."""
    plain = large_rig()
    rig = plain.with_needle(_designed_needle())
    assert rig.world is not None
    needle = rig.world.needle
    assert (needle.diameter_mm, needle.link_mm) == (1.4, 3.5)
    assert needle.design == DesignDescription(radius_low_mm=42.5, radius_high_mm=48.0)
    assert rig.calibration_paths() == plain.calibration_paths()
    with pytest.raises(FileFormatError, match=r"2\.2 mm; must be below sheath.diameter_mm, 2 mm"):
        plain.with_needle(_designed_needle(2.2))
