"""Graph paper before and after a run, the sheath before each insertion of a roll zero, and bumped cameras."""

import math
from pathlib import Path

import pytest

from labrig.analysis.result import AnyResult
from labrig.analysis.run import analyze_run
from labrig.devices.operator import ConfirmPlan, OperatorRequest, ShiftToHole
from labrig.errors import CalibrationRefusedError, MeasurementRefusedError
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.insertion.result import InsertionResult
from labrig.experiments.registry import find_run_experiment
from labrig.experiments.roll_zero.result import RollZeroResult
from labrig.protocol.load import load_protocol
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.reader import Run, open_run
from labrig.runner.conduct import Outcome
from tests.analysis.synthetic import NOW, PROVENANCE
from tests.experiments.insertion.test_procedure import EVEN, insertion, open_certified_rig
from tests.pages import write_page
from tests.runner.sessions import PROTOCOLS, RunBench, Watched, bench, large_bench

NEAR = ("target.position_mm=[0,-2,20]", "sentinel={pitch_mm: 1}")
STEPS = ("roll_zero.rolls=5", "roll_zero.length_mm=12", "roll_zero.torsion=null")


def conduct(
    opened: RunBench, protocol: ExperimentProtocol, bump: float, when: type[object]
) -> tuple[Outcome, Run]:
    """Conduct a run whose camera moves closer by a share after the operator has answered a kind of request."""
    world, bumps = opened.opened.hardware.world, [bump]

    def then(request: OperatorRequest) -> None:
        if isinstance(request, when) and bumps:
            lens = world.description.lens
            moved = lens.model_copy(update={"distance_mm": lens.distance_mm * (1.0 - bumps.pop())})
            world.description = world.description.model_copy(update={"lens": moved})

    rig = opened.opened.rig
    rig.operator = Watched(rig.operator, then)
    return opened.conduct(protocol)


def analyse(run: Run) -> AnyResult:
    """Analyse a run."""
    return analyze_run(run, find_run_experiment(run), workers=1, created=NOW, provenance=PROVENANCE)


def page(run: Run, result: AnyResult) -> str:
    """Return the run's page."""
    return write_page(open_run(run.path), result, NOW).read_text(encoding="utf-8")


def test_drift_of_the_scale_stands_in_the_error_bar_of_a_target_error(tmp_path: Path) -> None:
    """A drift of 0.3 % enters the standard deviation of the target error, and the run succeeds."""
    protocol = insertion(*NEAR)
    with open_certified_rig(tmp_path, protocol, EVEN) as opened:
        outcome, run = conduct(opened, protocol, 0.003, ConfirmPlan)
    roles = run.frame_table["role"].tolist()
    assert (outcome.exit_status, roles[0], roles[-1]) == ("success", "grid-before", "grid-after")
    result = analyse(run)
    assert isinstance(result.content, InsertionResult)
    sentinel, (trial,) = result.content.sentinel, result.content.insertions
    assert sentinel is not None
    assert (sentinel.accepted, sentinel.drift) == (True, pytest.approx(0.003, abs=5e-4))
    assert trial.sigma_target_error_mm is not None
    reading_mm, drifted_mm = 0.073, 0.003 * 19.0
    assert trial.sigma_target_error_mm > math.hypot(reading_mm, drifted_mm) - 0.005
    assert "The plane map held" in page(run, result)


def roll_zero(*overrides: str) -> ExperimentProtocol:
    """Return a short search for the roll zero."""
    return load_protocol(PROTOCOLS / "roll-zero.yaml", PROTOCOL_MODELS, [*STEPS, *overrides])


def test_play_of_the_sheath_is_no_bend_of_the_needle(tmp_path: Path) -> None:
    """The zero is found, live and by analysis, in spite of a play of half a millimetre and a degree."""
    play = ("world.sheath.lateral_play_sd_mm=0.4", "world.sheath.angle_play_sd_deg=0.6")
    protocol = roll_zero("sentinel={pitch_mm: 1}")
    with large_bench(tmp_path, protocol, (*EVEN[:2], *play)) as opened:
        outcome, run = opened.conduct(protocol)
    assert outcome.exit_status == "success"
    (found,) = (event for event in run.lines("events") if event["kind"] == "roll_zero")
    assert abs(math.degrees(found["fit"]["zero_rad"])) < 2.0
    assert found["fit"]["residual_rms_mm"] < 0.1
    result = analyse(run)
    assert isinstance(result.content, RollZeroResult)
    assert result.content.accepted
    assert result.content.fit is not None
    assert result.content.fit["zero_rad"] == pytest.approx(found["fit"]["zero_rad"], abs=1e-9)
    assert [origin.accepted for origin in result.content.origins] == [True] * 5
    shown = page(run, result)
    assert ("Where the sheath stood" in shown, "The plane map held" in shown) == (True, True)


def test_a_bumped_camera_measures_nothing(tmp_path: Path) -> None:
    """After a bump of 2 % the answer is no: no target error is stated, and no zero is certified."""
    aimed, sought = insertion(*NEAR), roll_zero("sentinel={pitch_mm: 1}", "sheath.origin=null")
    with open_certified_rig(tmp_path, aimed, EVEN, bench) as opened:
        inserted = conduct(opened, aimed, 0.02, ConfirmPlan)
    with bench(tmp_path / "zero", sought, EVEN) as opened:
        turned = conduct(opened, sought, 0.02, ShiftToHole)
        assert opened.opened.rig.needle.recall_roll_zero("N1") is None
    results: list[AnyResult] = []
    for outcome, run in (inserted, turned):
        assert isinstance(outcome.error, CalibrationRefusedError)
        assert (outcome.exit_status, outcome.error.exit_code) == ("failed", 1)
        assert "the camera was bumped" in outcome.reason
        results.append(analyse(run))
        assert "the camera was bumped" in page(run, results[-1])
    of_insertion, of_zero = (result.content for result in results)
    assert isinstance(of_insertion, InsertionResult)
    assert isinstance(of_zero, RollZeroResult)
    (trial,) = of_insertion.insertions
    assert (trial.target_error_mm, trial.reached, of_insertion.reached) == (None, False, False)
    bumped = any("the camera was bumped" in reason for reason in of_zero.reasons)
    assert (of_zero.accepted, bumped) == (False, True)


def test_a_roll_zero_is_not_sought_from_a_sheath_that_slipped(tmp_path: Path) -> None:
    """If the sheath slipped by a millimetre the needle never leaves it, and the reason is stated."""
    protocol = roll_zero()
    with large_bench(tmp_path, protocol, (*EVEN, "world.sheath_tip_at_origin_linear_mm=16")) as opened:
        outcome, run = opened.conduct(protocol)
        assert opened.opened.rig.state.needle_in_tissue is False
    assert isinstance(outcome.error, MeasurementRefusedError)
    assert "the sheath slipped" in outcome.reason
    assert run.states["insertion_mm"].max() < 0.01
    assert abs(run.states.iloc[-1]["linear_mm"]) < 0.05
