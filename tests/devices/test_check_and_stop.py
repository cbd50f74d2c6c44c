"""`labrig devices check` and `stop`, below the command line."""

from datetime import datetime
from pathlib import Path

import can
import pytest

from labrig.devices.axis_description import AxisDescription
from labrig.devices.bus import open_can
from labrig.devices.camera import CameraContext
from labrig.devices.can_description import CanDescription
from labrig.devices.check import check_calibration, check_rig, list_calibration_ages
from labrig.devices.check_result import CheckResult, CheckStatus
from labrig.devices.clocks import SystemClock
from labrig.devices.drives.check import check_axis
from labrig.devices.drives.epos2 import Epos2Axis
from labrig.devices.drives.states import DriveState, decode_state
from labrig.devices.exclusive import acquire_rig
from labrig.devices.rig import open_rig
from labrig.devices.rig_file import load_rig
from labrig.devices.simulated.bus import attach
from labrig.devices.simulated.camera import SimulatedCameraDescription, SimulatedSource
from labrig.devices.stop import read_stop_target, stop_drives, stop_rig
from labrig.errors import BusError, LockedError, SafetyStopError
from labrig.vision.calibration_file import save_intrinsics
from labrig.vision.intrinsics import Intrinsics
from tests.devices.rigs import (
    ANSWER_TIMEOUT_S,
    BENCH,
    SIMULATED,
    OpenedRig,
    Person,
    Signal,
    epos2_axis,
    large_rig,
    one_drive,
    opened_rig,
    simulated_rig,
)

TARGET = read_stop_target(SIMULATED)


def _by_name(results: list[CheckResult]) -> dict[str, CheckResult]:
    return {result.check: result for result in results}


def _axis_results(opened: OpenedRig, axis: AxisDescription) -> list[CheckResult]:
    assert isinstance(axis, Epos2Axis)
    return list(check_axis(opened.hardware.open_link(), axis, "linear", opened.hardware.clock))


def test_the_simulated_rig_is_in_order() -> None:
    """Bus, drives, encoders, limits, camera and state pass; the run itself sets references."""
    results = _by_name(check_rig(large_rig()))
    for name in (
        "bus",
        "drive insertion",
        "drive linear",
        "guards rotation",
        "camera picture",
        "rig state",
    ):
        assert results[name].status is CheckStatus.PASS, results[name]
    assert results["reference insertion"].status is CheckStatus.WARN


def test_other_software_of_a_drive_is_warned_of() -> None:
    """The check names the version, and those whose objects labrig knows."""
    with one_drive(software=0x2126) as one:
        link = attach(one.wire, one.clock, ANSWER_TIMEOUT_S)
        found = next(check_axis(link, one.driver.section, "insertion", one.clock))
        assert found.status is CheckStatus.WARN
        assert (
            "serial 1001, fingerprint [0, 0]; labrig knows the objects of software 0x2110 and 0x2122"
            in found.value
        )
        link.close()


def test_a_bench_without_bus_camera_or_figures_fails_line_by_line() -> None:
    """Nothing is raised: each missing part is a FAIL with a remedy."""
    results = check_rig(load_rig(BENCH))
    failed = _by_name([result for result in results if result.status is CheckStatus.FAIL])
    for name in ("axes.insertion.lead_mm", "bus", "drive rotation", "calibration plane"):
        assert failed[name].solution
    assert "type can bitrate 1000000" in failed["bus"].solution
    assert all(result.solution for result in results if result.status is not CheckStatus.PASS)


def test_a_camera_that_ignores_a_setting_fails_the_check() -> None:
    """The row names the setting."""
    results = _by_name(check_rig(large_rig("world.ignores=[exposure_us]")))
    assert results["camera"].status is CheckStatus.FAIL
    assert "exposure_us" in results["camera"].value


def test_a_simulated_rig_with_unknown_entries_fails_the_check() -> None:
    """It cannot be simulated, and the missing entry is named."""
    results = _by_name(check_rig(large_rig("axes.linear.lead_mm=null")))
    assert results["axes.linear.lead_mm"].status is CheckStatus.FAIL
    assert results["rig"].status is CheckStatus.FAIL


def test_a_wrong_encoder_fails_the_check() -> None:
    """A resolution that differs from the rig file, or that the rig file does not know, fails with that of the drive."""
    with opened_rig() as opened:
        for pulses in (512, None):
            axis = large_rig().axes.linear.model_copy(update={"encoder_pulses_per_turn": pulses})
            result = _by_name(_axis_results(opened, axis))["encoder and units linear"]
            assert result.status is CheckStatus.FAIL
            assert "encoder_pulses_per_turn 500" in result.value


def test_a_faulted_drive_fails_the_check() -> None:
    """The fault is named, and the check resets nothing."""
    with opened_rig() as opened:
        opened.drives["linear"].fail(0x4210)
        axis = large_rig().axes.linear
        results = _axis_results(opened, axis)
        failed = [result for result in results if result.status is CheckStatus.FAIL]
        assert "over-temperature" in failed[0].value
        assert decode_state(opened.drives["linear"]._statusword()) is DriveState.FAULT


def test_hints_with_commands_name_the_rig_file() -> None:
    """A copied command must not drive the simulated rig by default."""
    for result in check_rig(load_rig(BENCH)):
        for command in ("labrig run", "calibrate adopt", "devices home --axis"):
            assert command not in result.solution or f"--rig {BENCH}" in result.solution


def test_a_needle_in_tissue_fails_the_check(tmp_path: Path) -> None:
    """The state of the rig is part of the check, with a remedy."""
    description = large_rig("state_file=state.json").placed_in(tmp_path)
    new = _by_name(check_rig(description))["rig state"]
    assert new.status is CheckStatus.WARN
    assert "labrig devices jog and home" in new.solution
    with open_rig(description, seed=1, person=Person(), interrupted=Signal()) as rig:
        rig.needle.mark_in_tissue("run-3")
    result = _by_name(check_rig(description))["rig state"]
    assert (result.status, result.value) == (CheckStatus.FAIL, "run run-3 ended with the needle in tissue")


def _lens(width: int, *, accepted: bool = True) -> Intrinsics:
    """Return the calibration of a lens; only what a check looks at is meant."""
    sigma = {"fx": 1.0, "fy": 1.0, "cx": 1.0, "cy": 1.0}
    size, why = (width, 720), () if accepted else ("too few views",)
    return Intrinsics(size, 1800.0, 1800.0, 640.0, 360.0, (0.0,) * 5, sigma, 0.1, 0.1, (), accepted, why)


@pytest.mark.parametrize(
    ("lens", "status", "words"),
    [
        (_lens(1280), CheckStatus.PASS, "1280x720 px, rms 0.100 px"),
        (_lens(640), CheckStatus.FAIL, "made for 640x720 px, the camera gives 1280x720 px"),
        (_lens(1280, accepted=False), CheckStatus.FAIL, "too few views"),
    ],
)
def test_a_calibration_is_checked_against_the_camera(
    tmp_path: Path, lens: Intrinsics, status: CheckStatus, words: str
) -> None:
    """One for another picture size, or a refused one, fails; a missing plane map says how to make it."""
    save_intrinsics(tmp_path / "simulated-intrinsics.json", lens, {})
    results = _by_name(check_rig(large_rig().placed_in(tmp_path)))
    assert results["calibration intrinsics"].status is status
    assert words in results["calibration intrinsics"].value
    assert "protocols/calibration.yaml" in results["calibration plane"].solution


@pytest.mark.parametrize(
    ("made_with", "changes", "status", "words"),
    [
        ({"focus": 5}, {"focus": 5}, CheckStatus.PASS, "1280x720 px"),
        ({"focus": 5}, {"focus": 7}, CheckStatus.FAIL, "made with camera.focus 5, it is 7 now"),
        (
            {"pixel_format": "YUYV"},
            {},
            CheckStatus.FAIL,
            "made with camera.pixel_format YUYV, it is GREY now",
        ),
        ({"gain": 3}, {}, CheckStatus.PASS, "1280x720 px"),
        ({"focus": 5}, {"focus": None}, CheckStatus.PASS, "1280x720 px"),
    ],
)
def test_another_focus_or_format_voids_a_calibration(
    tmp_path: Path, made_with: dict[str, object], changes: dict[str, object], status: CheckStatus, words: str
) -> None:
    """The setting is named with its value then and now; what changes brightness alone voids nothing."""
    save_intrinsics(tmp_path / "simulated-intrinsics.json", _lens(1280), {"camera": {"settings": made_with}})
    rig = large_rig().placed_in(tmp_path)
    rig = rig.model_copy(update={"camera": rig.camera.model_copy(update=changes)}).placed_in(tmp_path)
    results = _by_name(list(check_calibration(rig)))
    assert results["calibration intrinsics"].status is status
    assert words in results["calibration intrinsics"].value


def test_a_camera_that_reports_another_focus_fails_the_check(tmp_path: Path) -> None:
    """Where the rig file sets no focus, that of the open camera is compared."""
    save_intrinsics(
        tmp_path / "simulated-intrinsics.json", _lens(1280), {"camera": {"settings": {"focus": 12}}}
    )
    result = _by_name(check_rig(large_rig().placed_in(tmp_path)))["camera"]
    assert (result.status, result.value) == (
        CheckStatus.FAIL,
        "simulated-intrinsics.json was made with camera.focus 12, it is 0 now",
    )


def test_a_damaged_calibration_fails_the_check(tmp_path: Path) -> None:
    """A damaged file is a FAIL with the reason, not an exception."""
    (tmp_path / "simulated-intrinsics.json").write_text("{}", encoding="utf-8")
    result = _by_name(check_rig(large_rig().placed_in(tmp_path)))["calibration intrinsics"]
    assert result.status is CheckStatus.FAIL
    assert result.solution


def test_stopping_from_outside_stops_every_drive() -> None:
    """Every quick stop is sent before one is answered; all are seen to stand still, and put into NMT STOPPED."""
    with opened_rig() as opened:
        opened.rig.connect()
        opened.rig.reference_axes()
        opened.rig.axis("insertion").start_move(100.0, 1.0)
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
        assert [drive.shaft_counts for drive in opened.drives.values()] == positions


def test_drives_that_were_stopped_before_are_known_to_stand_still() -> None:
    """A node in NMT STOPPED answers no SDO: it is woken and read."""
    with opened_rig() as opened:
        for _ in range(2):
            done = stop_drives(TARGET, opened.hardware.open_link(), opened.hardware.clock)
            assert sum("stands still" in line for line in done) == 3


def test_a_rig_that_was_stopped_from_outside_opens_again() -> None:
    """A node in NMT STOPPED answers no SDO; opening the rig starts it again, and nothing moves."""
    with opened_rig() as opened:
        link = opened.hardware.open_link()
        stop_drives(TARGET, link, opened.hardware.clock)
        link.close()
        opened.hardware.clock.sleep(1.0)
        opened.rig.connect()
        assert decode_state(opened.rig.read_states()["linear"].statusword) is DriveState.OPERATION_ENABLED
        assert all(drive.shaft_counts == 0 for drive in opened.drives.values())


def test_stopping_from_outside_names_a_drive_that_does_not_answer() -> None:
    """The other drives are stopped all the same."""
    with opened_rig() as opened:
        opened.rig.connect()
        opened.rig.reference_axes()
        opened.rig.axis("linear").start_move(100.0, 5.0)
        opened.rig.wait(1.0)
        opened.drives["insertion"].unplug()
        with pytest.raises(SafetyStopError, match=r"axis insertion \(node 1\) did not answer.*sent NMT stop"):
            stop_drives(TARGET, opened.hardware.open_link(), opened.hardware.clock)
        statusword = opened.drives["linear"]._statusword()
        # Meanwhile the rig did not beat, so that the drive has also stopped by itself.
        assert decode_state(statusword) in {DriveState.QUICK_STOP_ACTIVE, DriveState.FAULT}


def test_stopping_a_simulated_rig_says_that_there_is_nothing_to_stop() -> None:
    """It has no bus to open; its drives end with the labrig that runs them."""
    assert stop_rig(TARGET) == (
        "no labrig has the rig",
        "its drives are simulated inside the labrig that runs them: Ctrl+C there stops them",
    )


def test_stopping_a_bench_without_a_bus_is_an_error() -> None:
    """It must not look as if the drives had been stopped."""
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
        open_can(CanDescription(interface=interface, channel=channel, bitrate=1_000_000), SystemClock())
    assert hint in refusal.value.hint


def test_a_real_python_can_bus_serves_as_well() -> None:
    """The link over python-can's own virtual interface opens, sends and closes."""
    link = open_can(
        CanDescription(interface="virtual", channel="labrig-test", bitrate=1_000_000), SystemClock()
    )
    other = can.Bus(interface="virtual", channel="labrig-test")
    link.send(0x000, b"\x02\x00")
    message = other.recv(1.0)
    assert message is not None
    assert bytes(message.data) == b"\x02\x00"
    other.shutdown()
    link.close()


def test_the_fingerprint_is_checked() -> None:
    """It is told, to be entered into the rig file; another one than there fails."""
    with opened_rig() as opened:
        axis = simulated_rig().axes.linear
        assert "fingerprint [0, 0]" in _by_name(_axis_results(opened, axis))["drive linear"].value
        named = axis.model_copy(update={"configuration_fingerprint": (1, 2)})
        assert _by_name(_axis_results(opened, named))["fingerprint linear"].status is CheckStatus.FAIL


def test_a_drive_accepted_by_its_hardware_version_is_a_warning() -> None:
    """Nobody has tried its type with labrig: the check says so, and the rig is usable."""
    axis = epos2_axis(hardware_version=0x6552)
    with one_drive(hardware=0x6552) as bench:
        link = attach(bench.wire, bench.clock, ANSWER_TIMEOUT_S)
        drive = _by_name(list(check_axis(link, axis, "insertion", bench.clock)))["drive insertion"]
        link.close()
    assert drive.status is CheckStatus.WARN
    assert "hardware version 0x6552" in drive.value
    assert "check that its label says EPOS2" in drive.value


def test_a_rig_in_use_is_left_alone(tmp_path: Path) -> None:
    """Its user is named; its bus is not opened."""
    description = large_rig("state_file=state.json").placed_in(tmp_path)
    with open_rig(description, seed=1, person=Person(), interrupted=Signal(), doing="labrig run x.yaml"):
        results = _by_name(check_rig(description))
    assert results["rig"].status is CheckStatus.WARN
    assert "labrig run x.yaml" in results["rig"].value
    assert "bus" not in results


class _Intruder(SimulatedCameraDescription):
    """A camera that is opened while another labrig wants the rig."""

    def open(self, context: CameraContext) -> SimulatedSource:
        """Want it."""
        rig = large_rig("state_file=state.json").placed_in(context.folder)
        with pytest.raises(LockedError, match="labrig devices check"), acquire_rig(rig, "labrig run x.yaml"):
            pass
        return super().open(context)


def test_a_rig_that_is_checked_is_in_use(tmp_path: Path) -> None:
    """Nobody opens it while its bus and camera are looked at."""
    rig = large_rig("state_file=state.json")
    camera = _Intruder.model_validate(rig.camera.model_dump())
    results = _by_name(check_rig(rig.model_copy(update={"camera": camera}).placed_in(tmp_path)))
    assert results["camera picture"].status is CheckStatus.PASS


def test_the_age_of_a_calibration_is_reported(tmp_path: Path) -> None:
    """In days; an old one of a bench, and one of unknown age, are warnings."""
    provenance = {"created": "2026-01-01T00:00:00+00:00"}
    save_intrinsics(tmp_path / "bench-intrinsics.json", _lens(1280), provenance)
    rig = load_rig(BENCH).placed_in(tmp_path)
    for day, status in (("2026-01-31", CheckStatus.PASS), ("2026-02-01", CheckStatus.WARN)):
        now = datetime.fromisoformat(f"{day}T00:00:00+00:00")
        assert next(list_calibration_ages(rig, now)).status is status
    save_intrinsics(tmp_path / "bench-intrinsics.json", _lens(1280), {})
    unknown = next(list_calibration_ages(rig, now))
    assert (unknown.status, unknown.value) == (CheckStatus.WARN, "when it was made is not known")


def test_currents_and_inputs_are_checked() -> None:
    """Limits of rig file and drive are named; an open door is a warning, because no run begins."""
    channels = (
        "axes.insertion.inputs={force: {source: analog-1, unit: N, units_per_volt: 10, limits: [-5, 5]}}",
        "axes.linear.inputs={door: {source: general-A, expected: true}}",
    )
    limits = ("axes.rotation.max_current_ma=800", "axes.linear.max_current_ma=12000")
    open_door = "faults=[{fault: input, axis: linear, source: general-A}]"
    results = _by_name(check_rig(large_rig(*channels, *limits, open_door)))
    assert results["current insertion"].status is CheckStatus.WARN
    assert (
        "limit 10000 mA, the drive's own; not guarded against a stall" in results["current insertion"].value
    )
    assert results["current rotation"].value == "0 mA; limit 800 mA, the drive's own 10000 mA"
    assert results["current linear"].status is CheckStatus.FAIL
    assert "10000 mA, the rig file says max_current_ma 12000" in results["current linear"].value
    assert results["input force"].status is CheckStatus.PASS
    assert results["input force"].value == "0 N at analog-1 of the drive of axis insertion, limits [-5, 5] N"
    assert results["input door"].status is CheckStatus.WARN
    assert results["input door"].solution
