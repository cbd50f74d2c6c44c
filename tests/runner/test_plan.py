"""The plan of a run, before anything moves."""

from pathlib import Path

import pytest

from labrig.devices.rig_file import load_rig
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.protocol.load import load_protocol
from labrig.record.events import Move, OperatorQuestion
from tests.devices.rigs import BENCH, large_rig
from tests.runner.sessions import ONE_INSERTION, PROTOCOLS, bench, find_problems, plan_of, sweep

LIMITS = [
    ("insertion.length_mm=500", "rig axes.insertion", "500 mm is beyond its limits [-2, 120]"),
    ("insertion.speed_mm_s=50", "rig axes.insertion", "speed 50 mm/s is not within 0 to 20 mm/s"),
    ("sheath.speed_mm_s=60", "rig axes.linear", "speed 60 mm/s is not within 0 to 20 mm/s"),
    ("sheath.depth_mm=400", "rig axes.linear", "400 mm is beyond its limits [-5, 150]"),
    ("needle.diameter_mm=0.0012", "needle.diameter_mm", "pixels wide, and 2.5 is the least"),
]


@pytest.mark.parametrize(("setting", "where", "told"), LIMITS)
def test_what_is_beyond_a_limit_is_named_with_both_numbers(setting: str, where: str, told: str) -> None:
    """A move at its axis, a needle that no camera sees; it does not end the dry run, so that all are told."""
    problems = find_problems(sweep(setting), large_rig())
    assert {problem.where for problem in problems} == {where}
    assert any(told in problem.message for problem in problems)


def test_an_arc_that_leads_across_the_next_track_or_out_of_the_gel_is_doubted() -> None:
    """Arcs of 27 mm, 10 mm beside each other, are 2.4 mm apart after 40.6 mm; half a circle and 15 mm are 99.8 mm."""
    for length_mm, holes, end in ((40, 2, ""), (41, 2, "of a track"), (99, 1, ""), (100, 1, "back out")):
        far = sweep(f"insertion.length_mm={length_mm}", f"insertions_per_specimen={holes}")
        told = " ".join(doubt.message for doubt in plan_of(far, large_rig()).warnings)
        assert (end in told, bool(told)) == (True, bool(end))


def test_a_rig_that_is_not_whole_or_calibrated_otherwise_cannot_run() -> None:
    """Every null in the bench file says where to find the number; another size of pictures is named with both."""
    problems = find_problems(sweep(), load_rig(BENCH))
    unknown = {"rig axes.insertion.lead_mm", "rig axes.linear.gear_ratio"}
    assert unknown <= {problem.where for problem in problems}
    assert all(problem.hint for problem in problems)
    small = (
        f"{part}.{side}" for part in ("camera", "world.lens") for side in ("width_px=640", "height_px=480")
    )
    messages = " ".join(problem.message for problem in find_problems(sweep(), large_rig(*small)))
    assert "1280x720" in messages
    assert "640x480" in messages


@pytest.mark.parametrize(
    ("name", "overrides", "within"),
    [
        ("steerability", ONE_INSERTION, 0.02),
        ("calibration", ("views=6", "plane.origin_px=[123,112]"), 0.02),
        ("roll-zero", ("roll_zero.rolls=5", "roll_zero.length_mm=12", "roll_zero.torsion=null"), 0.1),
        ("insertion", ("target.position_mm=[0,2,20]", "obstacles=[]", "insertion.max_length_mm=30"), 0.1),
    ],
)
def test_the_dry_run_does_what_the_run_does(
    name: str, overrides: tuple[str, ...], within: float, tmp_path: Path
) -> None:
    """Moves, pictures and questions are those of the run where nothing measured decides them, and so is its time."""
    protocol = load_protocol(PROTOCOLS / f"{name}.yaml", PROTOCOL_MODELS, list(overrides))
    with bench(tmp_path, protocol) as rig:
        plan = plan_of(protocol, rig.opened.rig.description)
        opened_s = rig.opened.rig.clock.now_s()  # an estimate leaves out what opening the drives takes
        outcome, run = rig.conduct(protocol)
        took_s = rig.opened.rig.clock.now_s() - opened_s
    assert (outcome.exit_status, plan.problems) == ("success", ())
    assert plan.duration_s == pytest.approx(took_s, rel=within, abs=0.3)  # power on and off
    made = [
        len(run.read_events(Move)),
        len(run.read_events(OperatorQuestion)),
        sum(not line.drawn for line in run.frame_lines),
    ]
    if within < 0.1:
        assert made == [plan.moves, plan.operator_steps, plan.pictures]
    else:
        assert made == pytest.approx([plan.moves, plan.operator_steps, plan.pictures], rel=0.2)


def test_a_current_above_that_of_the_rig_file_is_named_with_both() -> None:
    """A protocol can only ask for less; a rig file without a limit takes any."""
    protocol = sweep("max_current_ma={insertion: 900, linear: 300}")
    rig = large_rig("axes.insertion.max_current_ma=800", "axes.linear.max_current_ma=800")
    problems = find_problems(protocol, rig)
    assert [problem.where for problem in problems] == ["max_current_ma.insertion"]
    assert problems[0].message == "900 mA is above the limit of the rig file, 800 mA"
    assert find_problems(protocol, large_rig()) == ()


def test_a_bench_is_taken_to_have_the_markers_that_a_protocol_follows() -> None:
    """Nobody knows before a run whether they are seen: they refuse nothing, and the insertion is planned to its end."""
    bound = (
        "target.position_mm=[0,2,20]", "obstacles=[]", "insertion.max_length_mm=30", "target.marker_id=7",
    )  # fmt: skip
    protocol = load_protocol(PROTOCOLS / "insertion.yaml", PROTOCOL_MODELS, [*bound, "markers={side_mm: 6}"])
    without = load_protocol(PROTOCOLS / "insertion.yaml", PROTOCOL_MODELS, list(bound[:3]))
    rig = large_rig().model_copy(update={"world": None})
    plan = plan_of(protocol, rig)
    assert plan.refusal is None
    assert "marker" not in " ".join(problem.message for problem in plan.problems)
    assert plan.moves == pytest.approx(plan_of(without, rig).moves, rel=0.2)
