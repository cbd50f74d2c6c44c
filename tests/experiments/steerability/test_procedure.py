"""The procedure of a sweep: its moves, questions and records, and how it ends when something fails."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labrig.devices.operator import (
    ConfirmAxesAtZero,
    ConfirmNeedleOut,
    MountNeedle,
    OperatorRequest,
    PlaceSpecimen,
    ShiftToHole,
)
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.record.json_lines import read_lines
from labrig.record.reader import Run
from labrig.report.tables import run_tables
from labrig.runner.conduct import Outcome
from tests.runner.sessions import SHORT_WAY, Watched, bench, sweep
from tests.runner.test_pausing import require_identical

INPUTS = (
    "axes.insertion.inputs={needle_force: {source: analog-1, unit: N, units_per_volt: 10}}",
    "axes.linear.inputs={door: {source: general-A, expected: true}}",
)


@dataclass(frozen=True)
class Swept:
    """A sweep of two holes that went well: how it ended, its record, and what the bench was like before and after."""

    outcome: Outcome
    run: Run
    before: Mapping[str, Any]
    asked: Sequence[OperatorRequest]
    done: Sequence[float]
    needle_in_tissue: bool | None


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Swept:
    """Make the sweep, once for the tests that only look at it."""
    protocol = sweep("insertions_per_specimen=2")
    with bench(tmp_path_factory.mktemp("sweep"), protocol) as rig:
        before = rig.opened.rig.snapshot()
        watched = rig.opened.rig.operator = Watched(rig.opened.rig.operator)
        outcome, run = rig.conduct(protocol)
        return Swept(
            outcome, run, before, watched.asked, rig.told.done, rig.opened.rig.state.needle_in_tissue
        )


def test_a_sweep_ends_with_needle_and_sheath_where_they_started(swept: Swept) -> None:
    """After a success both are back at zero, the rig knows that no needle is in tissue, and progress went forward."""
    assert (swept.outcome.exit_status, swept.outcome.error, swept.needle_in_tissue) == (
        "success",
        None,
        False,
    )
    assert swept.run.states.iloc[-1][["insertion_mm", "linear_mm"]].abs().max() < 0.05
    assert swept.done == sorted(swept.done)


def test_the_record_holds_the_devices_before_and_after(swept: Swept) -> None:
    """The states of drives and camera are recorded before power is on, and at the end of a run."""
    after: Any = read_lines(swept.run.path / "devices.jsonl")[-1]["devices"]
    assert set(swept.before["axes"]["rotation"]) == {"position_rad"}
    assert set(after["axes"]["rotation"]) == {"position_rad", "statusword"}
    assert swept.before["camera"]["exposure_us"] == after["camera"]["exposure_us"] == 8000
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


def test_the_operator_is_asked_in_the_order_of_the_bench(swept: Swept) -> None:
    """The operator is asked for needle, zero, specimen, and then each hole."""
    order = [MountNeedle, ConfirmAxesAtZero, PlaceSpecimen, ShiftToHole, ShiftToHole]
    assert [type(request) for request in swept.asked] == order


def test_every_state_line_has_currents_and_inputs(tmp_path: Path) -> None:
    """So have the tables of an export; the limits of the protocol hold; the replay is identical."""
    protocol = sweep(*SHORT_WAY, "insertion.length_mm=5", "max_current_ma={insertion: 700}")
    with bench(tmp_path, protocol, INPUTS) as rig:
        outcome, run = rig.conduct(protocol)
    assert outcome.error is None
    states = run_tables(run, None)["states"]
    assert {"insertion_current_ma", "rotation_current_ma", "linear_current_ma"} <= set(states)
    assert states["insertion_current_ma"].max() == -states["insertion_current_ma"].min() == pytest.approx(60)
    assert (states["input_needle_force_N"] == 0.0).all()
    assert states["input_door"].all()
    require_identical(run)


def test_the_needle_advances_at_the_set_speed_and_is_read_ten_times_a_second(swept: Swept) -> None:
    """The positions during an insertion lie on a line of 1 mm/s, a tenth of a second of rig time apart."""
    states = swept.run.states
    inserting = states[(states["insertion_mm"] > 5) & (states["insertion_mm"] < 35)].iloc[:250]
    times_s, depths_mm = inserting["t_s"].to_numpy(), inserting["insertion_mm"].to_numpy()
    assert (depths_mm[-1] - depths_mm[0]) / (times_s[-1] - times_s[0]) == pytest.approx(1.0, abs=0.01)
    assert np.diff(times_s) == pytest.approx(0.1, abs=1e-6)


def test_pictures_on_the_way_are_taken_at_their_depths(swept: Swept) -> None:
    """A picture is taken every 5 mm, at most a state period late, with the needle's position."""
    frames = swept.run.frame_table
    depths = frames[(frames["role"] == "advance") & (frames["trial"] == 0)]["insertion_mm"].tolist()
    assert len(depths) == 7
    assert all(0 <= depth - 5 * (index + 1) < 0.15 for index, depth in enumerate(depths))


def test_what_was_asked_and_what_was_sent_are_both_recorded(swept: Swept) -> None:
    """The event of a move holds requested position and speed, sent quadcounts and rpm, and the achieved speed."""
    events = swept.run.events
    first = events[(events["kind"] == "move") & (events["axis"] == "insertion")].iloc[0]
    assert (first["asked_position_mm"], first["asked_speed_mm_s"]) == (40.0, 1.0)
    assert first["sent_speed_units"] == round(first["sent_speed_units"]) > 0
    assert first["sent_counts"] == round(first["sent_counts"]) > 0


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


@pytest.mark.parametrize(
    ("length_mm", "pictures"), [(40.0, 7), (40.002, 7), (39.998, 7), (41.0, 8), (39.0, 7)]
)
def test_a_picture_on_the_way_is_not_taken_at_the_end(length_mm: float, pictures: int) -> None:
    """A length that is told, or rounded, to some micrometres more has no second picture of its end."""
    protocol = sweep(f"insertion.length_mm={length_mm}", "insertion.frame_every_mm=5")
    assert isinstance(protocol, SteerabilityProtocol)
    assert len(protocol.insertion.list_stops_mm()) == pictures
