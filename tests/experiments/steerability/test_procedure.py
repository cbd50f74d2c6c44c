"""The procedure of a sweep: its moves, questions and records, and how it ends when something fails."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import can
import pytest

from labrig.devices.operator import (
    ConfirmAxesAtZero,
    ConfirmNeedleOut,
    MountNeedle,
    PlaceSpecimen,
    ShiftToHole,
)
from labrig.errors import DriveError, InterruptedRunError, SafetyStopError
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.record.json_lines import read_lines
from tests.runner.sessions import Watched, bench, sweep


def test_a_sweep_ends_with_needle_and_sheath_where_they_started(tmp_path: Path) -> None:
    """After a success every axis is back at zero, and the rig knows that no needle is in tissue."""
    protocol = sweep()
    with bench(tmp_path, protocol) as rig:
        outcome, run = rig.conduct(protocol)
        assert (outcome.exit_status, outcome.error) == ("success", None)
        assert rig.opened.rig.state.needle_in_tissue is False
        last = run.states.iloc[-1]
        assert abs(last["insertion_mm"]) < 0.05
        assert abs(last["linear_mm"]) < 0.05


def test_the_record_holds_the_devices_before_and_after(tmp_path: Path) -> None:
    """The states of drives and camera are recorded before power is on, and at the end of a run."""
    protocol = sweep()
    with bench(tmp_path, protocol) as rig:
        before: Any = rig.opened.rig.snapshot()
        _, run = rig.conduct(protocol)
    after = read_lines(run.path / "devices.jsonl")[-1]["devices"]
    assert isinstance(after, dict)
    assert set(before["axes"]["rotation"]) == {"position_rad"}
    assert set(after["axes"]["rotation"]) == {"position_rad", "statusword"}
    for snapshot in (before, after):
        assert snapshot["camera"]["exposure_us"] == 8000
    assert abs(after["axes"]["insertion"]["position_mm"]) < 0.05
    assert after["state"]["referenced"] == ["insertion", "rotation", "linear"]


def test_a_device_that_does_not_answer_is_in_the_snapshot_with_its_reason(tmp_path: Path) -> None:
    """The snapshot lists a dead drive with its reason, and the other devices with their states."""
    with bench(tmp_path, sweep()) as rig:
        rig.opened.hardware.drives["rotation"].unplug()
        axes = rig.opened.rig.snapshot()["axes"]
        assert isinstance(axes, dict)
        assert set(axes["rotation"]) == {"error"}
        assert axes["linear"]["position_mm"] == 0.0


def test_the_operator_is_asked_in_the_order_of_the_bench(tmp_path: Path) -> None:
    """The operator is asked for needle, zero, specimen, and then each hole."""
    protocol = sweep("insertions_per_specimen=2")
    with bench(tmp_path, protocol) as rig:
        watched = rig.opened.rig.operator = Watched(rig.opened.rig.operator)
        rig.conduct(protocol)
    assert [type(request) for request in watched.asked] == [
        MountNeedle,
        ConfirmAxesAtZero,
        PlaceSpecimen,
        ShiftToHole,
        ShiftToHole,
    ]


def test_states_are_recorded_ten_times_a_second_while_moving(tmp_path: Path) -> None:
    """States of a move are a tenth of a second of rig time apart."""
    protocol = sweep()
    with bench(tmp_path, protocol) as rig:
        _, run = rig.conduct(protocol)
    inserting = run.states[(run.states["insertion_mm"] > 1) & (run.states["insertion_mm"] < 39)]
    steps = [after - before for before, after in pairwise(inserting["t_s"].iloc[:300])]
    assert max(abs(step - 0.1) for step in steps) < 1e-6


def test_the_needle_advances_at_the_set_speed(tmp_path: Path) -> None:
    """The positions during an insertion lie on a line of 1 mm/s."""
    protocol = sweep()
    with bench(tmp_path, protocol) as rig:
        _, run = rig.conduct(protocol)
    inserting = run.states[(run.states["insertion_mm"] > 5) & (run.states["insertion_mm"] < 35)].iloc[:250]
    speed = (inserting["insertion_mm"].iloc[-1] - inserting["insertion_mm"].iloc[0]) / (
        inserting["t_s"].iloc[-1] - inserting["t_s"].iloc[0]
    )
    assert abs(speed - 1.0) < 0.01


def test_pictures_on_the_way_are_taken_at_their_depths(tmp_path: Path) -> None:
    """A picture is taken every 5 mm, at most a state period late, with the needle's position."""
    protocol = sweep()
    with bench(tmp_path, protocol) as rig:
        _, run = rig.conduct(protocol)
    depths = run.frame_table[run.frame_table["role"] == "advance"]["insertion_mm"].tolist()
    assert len(depths) == 7
    assert all(0 <= depth - 5 * (index + 1) < 0.15 for index, depth in enumerate(depths))


def test_what_was_asked_and_what_was_sent_are_both_recorded(tmp_path: Path) -> None:
    """The event of a move holds requested position and speed, sent quadcounts and rpm, and the achieved speed."""
    protocol = sweep()
    with bench(tmp_path, protocol) as rig:
        _, run = rig.conduct(protocol)
    moves = run.events[(run.events["kind"] == "move") & (run.events["axis"] == "insertion")]
    first = moves.iloc[0]
    assert (first["asked_position_mm"], first["asked_speed_mm_s"]) == (40.0, 1.0)
    assert first["sent_rpm"] == round(first["sent_rpm"]) > 0
    assert first["sent_quadcounts"] == round(first["sent_quadcounts"]) > 0


def test_a_signal_in_the_middle_of_a_move_stops_the_axes(tmp_path: Path) -> None:
    """A signal during a move stops the needle, aborts the run, and leaves the needle recorded as in tissue."""
    protocol = sweep()
    with bench(tmp_path, protocol) as rig:
        clock = rig.opened.hardware.clock

        def after_ten_seconds() -> None:
            if clock.now_s() > 10:
                rig.opened.signal.name = "SIGINT"

        clock.on_advance(after_ten_seconds)
        outcome, run = rig.conduct(protocol)
        assert outcome.exit_status == "aborted"
        assert isinstance(outcome.error, InterruptedRunError)
        assert rig.opened.rig.state.needle_in_tissue is True
        stood = rig.opened.rig.read_states()["insertion"].position
        clock.sleep(0.4)
        assert rig.opened.rig.read_states()["insertion"].position == stood
    assert 0 < stood < 40
    with can.LogReader(run.path / "can.log") as frames:
        assert any(frame.arbitration_id == 0x77F for frame in frames)
    assert "can.log" in (run.path / "SHA256SUMS").read_text(encoding="utf-8")
    assert run.manifest["exit_status"] == "aborted"
    assert run.trials["exit_status"].tolist() == ["incomplete"]


def test_a_fault_of_a_drive_fails_the_run_by_name(tmp_path: Path) -> None:
    """A following error during an insertion fails the run, with axis and fault named."""
    protocol = sweep()
    with bench(tmp_path, protocol) as rig:
        clock = rig.opened.hardware.clock
        struck: list[float] = []

        def lag() -> None:
            if clock.now_s() > 10 and not struck:
                struck.append(clock.now_s())
                rig.opened.hardware.drives["insertion"].fail(0x8611)

        clock.on_advance(lag)
        outcome, run = rig.conduct(protocol)
    assert outcome.exit_status == "failed"
    assert isinstance(outcome.error, DriveError)
    assert "insertion" in outcome.reason
    assert "following error" in outcome.reason.lower()
    assert run.manifest["exit_status"] == "failed"


def test_a_drive_that_falls_silent_fails_the_run_and_the_record_is_closed(tmp_path: Path) -> None:
    """If stopping cannot be confirmed the record states it with the first fault, and is closed."""
    protocol = sweep()
    with bench(tmp_path, protocol) as rig:
        clock = rig.opened.hardware.clock

        def unplug() -> None:
            if clock.now_s() > 10:
                rig.opened.hardware.drives["insertion"].unplug()

        clock.on_advance(unplug)
        outcome, run = rig.conduct(protocol)
    assert outcome.exit_status == "failed"
    assert run.manifest["exit_status"] == "failed"
    assert (run.path / "SHA256SUMS").is_file()


def test_an_operator_who_says_no_ends_the_run(tmp_path: Path) -> None:
    """A declined request aborts the run before the needle moves, and is recorded."""
    protocol = sweep()
    with bench(tmp_path, protocol) as rig:
        rig.opened.rig.operator = Watched(rig.opened.rig.operator, declines=PlaceSpecimen)
        outcome, run = rig.conduct(protocol)
    assert outcome.exit_status == "aborted"
    assert isinstance(outcome.error, SafetyStopError)
    answers = run.events[run.events["kind"] == "operator"]
    assert not answers.iloc[-1]["confirmed"]
    assert run.trials.empty


def test_a_needle_left_in_tissue_is_asked_about_first(tmp_path: Path) -> None:
    """A needle that may be in tissue is asked about before any axis is referenced; a no ends the run."""
    protocol = sweep()
    with bench(tmp_path, protocol) as rig:
        rig.opened.rig.needle.mark_in_tissue("an earlier run")
        watched = rig.opened.rig.operator = Watched(rig.opened.rig.operator, declines=ConfirmNeedleOut)
        outcome, run = rig.conduct(protocol)
        assert rig.opened.rig.state.needle_in_tissue is True
    assert [type(request) for request in watched.asked] == [ConfirmNeedleOut]
    assert outcome.exit_status == "aborted"
    assert run.events[run.events["kind"] == "move"].empty


def test_progress_only_goes_forward(tmp_path: Path) -> None:
    """Progress never decreases, and ends at the total."""
    protocol = sweep("insertions_per_specimen=2")
    with bench(tmp_path, protocol) as rig:
        rig.conduct(protocol)
        assert rig.told.done == sorted(rig.told.done)


@pytest.mark.parametrize(
    ("length_mm", "pictures"), [(40.0, 7), (40.002, 7), (39.998, 7), (41.0, 8), (39.0, 7)]
)
def test_a_picture_on_the_way_is_not_taken_at_the_end(length_mm: float, pictures: int) -> None:
    """A length that is told, or rounded, to some micrometres more has no second picture of its end."""
    protocol = sweep(f"insertion.length_mm={length_mm}", "insertion.frame_every_mm=5")
    assert isinstance(protocol, SteerabilityProtocol)
    assert len(protocol.insertion.list_stops_mm()) == pictures
