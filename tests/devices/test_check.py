"""`labrig devices check`, below the command line."""

import os
from collections.abc import Iterable
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from labrig.devices.check import check_calibration, check_rig
from labrig.devices.check_result import CheckResult, CheckStatus
from labrig.devices.drives import objects as co
from labrig.devices.drives.check import check_axis
from labrig.devices.drives.objects import Place
from labrig.devices.drives.states import DriveState, decode_state
from labrig.devices.exclusive import acquire_rig
from labrig.devices.needle_state import NeedleState
from labrig.devices.rig_file import load_rig
from labrig.library.calibration_ages import list_calibration_ages
from labrig.vision.calibration_file import save_intrinsics
from labrig.vision.intrinsics import Intrinsics
from tests.devices.rigs import BENCH, epos2_axis, large_rig, one_drive, simulated_rig

PASS, WARN, FAIL = CheckStatus.PASS, CheckStatus.WARN, CheckStatus.FAIL
STATEFUL = simulated_rig("state_file=state.json")


def _by_name(results: Iterable[CheckResult]) -> dict[str, CheckResult]:
    return {result.check: result for result in results}


def test_the_simulated_rig_is_in_order() -> None:
    """Bus, drives, encoders, limits, camera and state pass; the run itself sets references."""
    results = _by_name(check_rig(simulated_rig()))
    for name in ("bus", "drive insertion", "drive linear", "guards rotation", "camera picture", "rig state"):
        assert results[name].status is PASS, results[name]
    assert "0x6007:00 = 1" in results["guards rotation"].value
    assert results["reference insertion"].status is WARN
    unknown = _by_name(check_rig(simulated_rig("axes.linear.lead_mm=null")))["rig"]
    assert (unknown.status, "axes.linear.lead_mm: unknown" in unknown.value) == (FAIL, True)


@pytest.mark.parametrize(
    ("drive", "section", "check", "status", "words"),
    [
        ({co.REVISION: 0x21260000}, {}, "drive", WARN, "its EDS file is for revision 0x21220000"),
        ({}, {}, "drive", PASS, "configuration_fingerprint [0, 0] (date, time"),
        ({}, {"configuration_fingerprint": (1, 2)}, "settings", FAIL, "[0, 0]"),
        ({}, {"counts_per_turn": 2048.0}, "settings", FAIL, "counts_per_turn 2000"),
        ({}, {"counts_per_turn": None}, "settings", FAIL, "counts_per_turn 2000"),
    ],
)  # fmt: skip
def test_a_drive_is_compared_with_its_section(
    drive: dict[Place, int], section: dict[str, object], check: str, status: CheckStatus, words: str
) -> None:
    """Versions that nobody has tried are warned of; an encoder or a fingerprint that differs fails with the drive's."""
    with one_drive(fixed=drive) as one:
        found = _by_name(check_axis(one.link, epos2_axis(**section), "insertion", one.clock))
    assert found[f"{check} insertion"].status is status
    assert words in found[f"{check} insertion"].value


def test_a_faulted_drive_fails_the_check() -> None:
    """The fault is named, and the check resets nothing."""
    with one_drive() as one:
        one.drive.fail(0x4210)
        results = list(check_axis(one.link, epos2_axis(), "insertion", one.clock))
        assert "over-temperature" in next(r.value for r in results if r.status is FAIL)
        assert decode_state(one.drive._statusword()) is DriveState.FAULT


def test_a_bench_without_bus_camera_or_figures_fails_line_by_line() -> None:
    """Nothing is raised: each missing part is a FAIL with a remedy; a copied command does not drive another rig."""
    results = check_rig(load_rig(BENCH))
    failed = _by_name(result for result in results if result.status is FAIL)
    for name in ("axes.insertion.lead_mm", "bus", "calibration plane"):
        assert failed[name].solution
    assert "type can bitrate 1000000" in failed["bus"].solution
    for result in results:
        assert result.solution or result.status is PASS
        for command in ("labrig run", "calibrate adopt", "devices home --axis"):
            assert command not in result.solution or f"--rig {BENCH}" in result.solution


def test_a_needle_in_tissue_fails_the_check(tmp_path: Path) -> None:
    """The state of the rig is part of the check, with a remedy."""
    description = STATEFUL.placed_in(tmp_path)
    new = _by_name(check_rig(description))["rig state"]
    assert new.status is WARN
    assert "labrig devices jog and home" in new.solution
    NeedleState(description.state_path).mark_in_tissue("run-3")
    result = _by_name(check_rig(description))["rig state"]
    assert (result.status, result.value) == (FAIL, "run run-3 ended with the needle in tissue")


def _save_lens(folder: Path, width: int = 1280, accepted: bool = True, **provenance: object) -> None:
    """Save the calibration of a lens for both rigs; only what a check looks at is meant."""
    sigma = {"fx": 1.0, "fy": 1.0, "cx": 1.0, "cy": 1.0}
    size, why = (width, 720), () if accepted else ("too few views",)
    lens = Intrinsics(size, 1800.0, 1800.0, 640.0, 360.0, (0.0,) * 5, sigma, 0.1, 0.1, (), accepted, why)
    for rig in ("simulated", "bench"):
        save_intrinsics(folder / f"{rig}-intrinsics.json", lens, provenance)


@pytest.mark.parametrize(
    ("lens", "made_with", "changes", "words"),
    [
        ({}, {}, {}, ""),
        ({"width": 640}, {}, {}, "made for 640x720 px, the camera gives 1280x720 px"),
        ({"accepted": False}, {}, {}, "too few views"),
        ({}, {"focus": 5}, {"focus": 5}, ""),
        ({}, {"focus": 5}, {"focus": 7}, "made with camera.focus 5, it is 7 now"),
        ({}, {"pixel_format": "YUYV"}, {}, "made with camera.pixel_format YUYV, it is GREY now"),
        ({}, {"gain": 3}, {}, ""),
        ({}, {"focus": 5}, {"focus": None}, ""),
    ],
)
def test_a_calibration_is_checked_against_the_camera(
    tmp_path: Path, lens: dict[str, Any], made_with: dict[str, object], changes: dict[str, object], words: str
) -> None:
    """One for another size, focus or format fails, and a refused one; what changes brightness alone voids nothing."""
    _save_lens(tmp_path, **lens, camera={"settings": made_with})
    rig = large_rig().model_copy(update={"camera": large_rig().camera.model_copy(update=changes)})
    results = _by_name(check_calibration(rig.placed_in(tmp_path)))
    assert results["calibration intrinsics"].status is (FAIL if words else PASS)
    assert (words or "1280x720 px, rms 0.100 px") in results["calibration intrinsics"].value
    assert "protocols/calibration.yaml" in results["calibration plane"].solution


def test_a_camera_that_reports_another_focus_fails_the_check(tmp_path: Path) -> None:
    """Where the rig file sets no focus, that of the open camera is compared."""
    _save_lens(tmp_path, camera={"settings": {"focus": 12}})
    results = _by_name(check_rig(large_rig().placed_in(tmp_path)))
    assert (results["camera"].status, results["calibration template"].status) == (FAIL, FAIL)
    assert results["camera"].value == "simulated-intrinsics.json was made with camera.focus 12, it is 0 now"
    assert "labrig calibrate template" in results["calibration template"].solution


def test_the_age_of_a_calibration_is_reported(tmp_path: Path) -> None:
    """In days; an old one of a bench, and one of unknown age, are warnings."""
    _save_lens(tmp_path, created="2026-01-01T00:00:00+00:00")
    rig = load_rig(BENCH).placed_in(tmp_path)
    for day, status in (("2026-01-31", PASS), ("2026-02-01", WARN)):
        now = datetime.fromisoformat(f"{day}T00:00:00+00:00")
        assert next(list_calibration_ages(rig, now)).status is status
    _save_lens(tmp_path)
    unknown = next(list_calibration_ages(rig, now))
    assert (unknown.status, unknown.value) == (WARN, "when it was made is not known")


def test_currents_inputs_and_camera_are_checked() -> None:
    """Limits of rig file and drive are named; an open door is a warning, because no run begins."""
    results = _by_name(
        check_rig(
            simulated_rig(
                "axes.insertion.inputs={force: {source: analog-1, unit: N, units_per_volt: 10, limits: [-5, 5]}}",
                "axes.linear.inputs={door: {source: general-A, expected: true}}",
                "axes.rotation.max_current_ma=800",
                "axes.linear.max_current_ma=26000",
                "faults=[{fault: input, axis: linear, source: general-A}]",
                "world.ignores=[exposure_us]",
            )
        )
    )
    for check, status, words in (
        ("current insertion", WARN, "limit 25000 mA, the drive's own setting; not guarded against a stall"),
        ("current rotation", PASS, "0 mA; limit 800 mA, the drive's own setting 25000 mA"),
        ("limits linear", FAIL, "has a limit of 25000, the rig file says max_current_ma 26000"),
        ("input force", PASS, "0 N at analog-1 of the drive of axis insertion, limits [-5, 5] N"),
        ("input door", WARN, "off"),
        ("camera", FAIL, "exposure_us"),
    ):
        assert results[check].status is status
        assert words in results[check].value
    assert results["input door"].solution


def test_a_rig_in_use_is_left_alone(tmp_path: Path) -> None:
    """Its user is named; its bus is not opened, also where only that is in use, by a rig of another file."""
    description = STATEFUL.placed_in(tmp_path)
    with acquire_rig(description, "labrig run x.yaml"):
        results = _by_name(check_rig(description))
    assert results["rig"].status is WARN
    assert "labrig run x.yaml" in results["rig"].value
    assert "bus" not in results
    other = load_rig(BENCH, [f"can.channel=can{os.getpid()}"])
    (tmp_path / "other").mkdir()
    with acquire_rig(other.placed_in(tmp_path), "labrig run x.yaml"):
        results = _by_name(check_rig(other.placed_in(tmp_path / "other")))
    assert results["rig"].status is WARN
    assert "bus" not in results
