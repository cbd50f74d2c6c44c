"""Checks of an insertion before anything moves."""

from pathlib import Path

import pytest

from labrig.devices.needle_state import NeedleState, RollZero
from labrig.devices.rig_file import load_rig
from labrig.errors import FileFormatError
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.settings import make_insertion_settings
from labrig.protocol.load import load_protocol
from labrig.protocol.sections import ExperimentProtocol
from labrig.protocol.yaml_file import dump_yaml
from labrig.steering.parameters import PAPER_POLICY
from tests.devices.rigs import large_rig
from tests.runner.sessions import PROTOCOLS, find_problems, plan_of

SIMULATED = Path(__file__).parents[3] / "calibration" / "rig-simulated.yaml"


def insertion(*overrides: str) -> ExperimentProtocol:
    """Return the example protocol with some values changed."""
    return load_protocol(PROTOCOLS / "insertion.yaml", PROTOCOL_MODELS, overrides)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("target.position_mm=[0,6,36]", "the target lies inside obstacle 1"),
        ("obstacles=[{position_mm: [0, 1, 0], radius_mm: 3}]", "the start lies inside obstacle 1"),
        ("target.position_mm=[0,4,130]", "lies outside of the tissue, which reaches from z -15 to 125 mm"),
        ("target.position_mm=[0,45,90]", "lies outside of the tissue"),
        ("target.position_mm=[0,36,90]", "lies outside of the camera's view"),
        ("target={pixel: [1279, 300]}", "lies outside of the camera's view"),
        ("insertion.max_length_mm=400", "400 mm is beyond its limits"),
        ("obstacles=[{position_mm: [0, 0, 200], radius_mm: 8}]", "z 200.0 mm, radius 8 mm, lies outside"),
        ("obstacles=[{pixel: [1000, 3000], radius_mm: 8}]", "pixel (1000.0, 3000.0) lies outside"),
        ("target={pixel: [1280, 300]}", "pixel (1280.0, 300.0) lies outside"),
        ("roll_zero=null", "needle N1 has no certified roll zero"),
    ],
)
def test_a_target_that_cannot_be_aimed_at_is_refused(override: str, message: str) -> None:
    """A target out of tissue or view is refused with its value and the limit."""
    assert any(message in problem.message for problem in find_problems(insertion(override), large_rig()))


def test_an_obstacle_counts_where_any_part_of_it_is_in_tissue_and_view() -> None:
    """One in the tissue but wholly out of view is refused at its key; one that reaches into the tissue is taken."""
    out = insertion("specimen.width_mm=200", "obstacles=[{position_mm: [0, -70, 60], radius_mm: 5}]")
    (problem,) = find_problems(out, large_rig())
    assert problem.where == "obstacles.0"
    assert "lies outside of the camera's view" in problem.message
    edge = insertion("obstacles=[{position_mm: [0, -44, 60], radius_mm: 12}]", "target={pixel: [1100, 290]}")
    assert find_problems(edge, large_rig()) == find_problems(insertion(), large_rig()) == ()


@pytest.mark.parametrize(("needle_id", "refused"), [("N1", 0), ("another", 1)])
def test_a_certified_roll_zero_need_not_be_found_again(tmp_path: Path, needle_id: str, refused: int) -> None:
    """A certified roll zero of this needle in the rig's state suffices; that of another needle does not."""
    rig, zero = large_rig(f"state_file={tmp_path / 'state.json'}"), RollZero(needle_id, 0.1, 0.01, "run-1")
    NeedleState(rig.state_path).update(referenced=("insertion", "rotation", "linear"), roll_zero=zero)
    problems = find_problems(insertion("roll_zero=null"), rig)
    assert sum(problem.where == "roll_zero" for problem in problems) == refused


def test_what_nobody_measured_is_not_taken_for_nothing() -> None:
    """On a rig that is not simulated a lag or a wandering of exactly 0 is refused, unless the torsion is measured."""
    bench = large_rig().model_copy(update={"kind": "bench"})
    never = insertion("out_of_plane.heading_sd_deg_per_root_mm=0")
    where = {problem.where for problem in find_problems(never, bench)}
    assert {"out_of_plane.lag_sd_deg", "out_of_plane.heading_sd_deg_per_root_mm"} <= where
    for stated in ("out_of_plane.lag_sd_deg=5", "roll_zero.torsion={}"):
        where = {problem.where for problem in find_problems(insertion(stated), bench)}
        assert not any(name.startswith("out_of_plane") for name in where)


@pytest.mark.parametrize("template", ["null", "none.png"])
def test_a_rig_without_a_template_is_refused_with_the_command_that_makes_one(template: str) -> None:
    """So is one whose file is missing, before anything moves."""
    (problem,) = find_problems(insertion(), load_rig(SIMULATED, [f"calibration.template={template}"]))
    assert problem.where == "calibration.template"
    assert template != "null" or "labrig calibrate template" in problem.hint


def test_what_the_answer_will_be_is_told_beforehand() -> None:
    """The planner's reason at the target's key; a tolerance that one camera cannot certify is warned of with why."""
    refusal = plan_of(insertion("target.position_mm=[0,25,12]"), large_rig()).refusal
    assert refusal is not None
    assert (refusal.where, "turning circle" in refusal.message) == ("target", True)
    plan = plan_of(insertion("out_of_plane.lag_sd_deg=5"), large_rig())
    assert (plan.problems, plan.refusal) == ((), None)
    (warning,) = plan.warnings
    assert warning.where == "target.tolerance_mm"
    assert "2 mm is below what one camera can certify" in warning.message
    assert "by the lag of the bevel" in warning.message
    assert "out_of_plane.lag_sd_deg" in warning.hint
    assert plan_of(insertion(), large_rig()).warnings == ()


def test_one_word_is_the_whole_of_the_papers_policy(tmp_path: Path) -> None:
    """The paper's planner and filter, no limit of the angle, and a file with every key says the same."""
    protocol = insertion("policy=paper")
    assert isinstance(protocol, InsertionProtocol)
    settings = make_insertion_settings(protocol, (0.0, 4.0, 100.0), ())
    assert settings.policy == PAPER_POLICY
    words = (settings.method, settings.estimator.method, protocol.policy.turning)
    assert words == ("paper", "paper", "back_and_forth")
    path = tmp_path / "resolved.yaml"
    path.write_text(dump_yaml(protocol), encoding="utf-8")
    assert load_protocol(path, PROTOCOL_MODELS) == protocol


@pytest.mark.parametrize(
    "beside",
    [
        "planner.method=best", "estimator.method=error-state", "estimator.radius_sd_mm=0",
        "estimator.cavity_every_mm=50", "estimator.slip_sd=0.01", "policy.near_mm=0",
    ],
)  # fmt: skip
def test_a_key_beside_the_papers_policy_is_refused(beside: str) -> None:
    """What the word decides cannot be set too."""
    with pytest.raises(FileFormatError, match=beside.partition("=")[0]):
        insertion("policy=paper", beside)
