"""The plan of a run, before anything moves."""

from pathlib import Path

from labrig.devices.rig_file import load_rig
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.steerability.procedure import list_trial_moves
from labrig.experiments.steerability.protocol import SteerabilityProtocol
from labrig.protocol.load import load_protocol
from tests.devices.rigs import BENCH, large_rig
from tests.runner.sessions import PROTOCOLS, bench, find_problems, plan_of, sweep


def test_the_example_protocol_suits_the_simulated_rig() -> None:
    """The example sweep has no problem on the simulated rig."""
    assert find_problems(load_protocol(PROTOCOLS / "steerability.yaml", PROTOCOL_MODELS), large_rig()) == ()


def test_a_move_beyond_a_limit_is_named_with_both_numbers() -> None:
    """A sheath depth beyond the linear axis is a problem at its key, with value and limit."""
    problems = find_problems(sweep("sheath.depth_mm=400"), large_rig())
    assert [problem.where for problem in problems] == ["sheath.depth_mm"]
    assert "400" in problems[0].message
    assert "150" in problems[0].message


def test_a_rig_with_unknown_entries_cannot_run() -> None:
    """Every null in the bench file is a problem that states where to find the number."""
    problems = find_problems(sweep(), load_rig(BENCH))
    assert {"rig axes.insertion.lead_mm", "rig axes.linear.gear_ratio"} <= {
        problem.where for problem in problems
    }
    assert all(problem.hint for problem in problems)


def test_a_calibration_for_another_picture_size_cannot_run() -> None:
    """A camera size other than the calibration's is refused with both sizes."""
    size = (
        "camera.width_px=640",
        "camera.height_px=480",
        "world.lens.width_px=640",
        "world.lens.height_px=480",
    )
    messages = " ".join(problem.message for problem in find_problems(sweep(), large_rig(*size)))
    assert "1280x720" in messages
    assert "640x480" in messages


def test_the_estimate_is_near_what_the_run_takes(tmp_path: Path) -> None:
    """The estimates of rig time and pictures are within a few percent of those of the run."""
    protocol = sweep()
    assert isinstance(protocol, SteerabilityProtocol)
    plan = plan_of(protocol, large_rig())
    with bench(tmp_path, protocol) as rig:
        opened_s = rig.opened.rig.clock.now_s()  # an estimate leaves out what opening the drives takes
        _, run = rig.conduct(protocol)
        took_s = rig.opened.rig.clock.now_s() - opened_s
    assert len(run.pictures) == plan.pictures
    assert abs(took_s - plan.duration_s) < 0.05 * plan.duration_s
    assert plan.trials == 1
    assert [move.axis for move in list_trial_moves(protocol)] == [
        "linear",
        "insertion",
        "insertion",
        "linear",
    ]


def test_a_current_above_that_of_the_rig_file_is_named_with_both() -> None:
    """A protocol can only ask for less; a rig file without a limit takes any."""
    protocol = sweep("max_current_ma={insertion: 900, linear: 300}")
    rig = large_rig("axes.insertion.max_current_ma=800", "axes.linear.max_current_ma=800")
    problems = find_problems(protocol, rig)
    assert [problem.where for problem in problems] == ["max_current_ma.insertion"]
    assert problems[0].message == "900 mA is above the limit of the rig file, 800 mA"
    assert find_problems(protocol, large_rig()) == ()
