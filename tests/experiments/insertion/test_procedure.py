"""The closed loop: its moves, questions and records, its endings, and what stops it."""

import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labrig.analysis.run import analyze_run
from labrig.devices.needle_state import RollZero
from labrig.devices.operator import (
    NO_OFFER,
    Answer,
    ConfirmPlan,
    ConfirmStopped,
    Offer,
    Operator,
    OperatorRequest,
    Paused,
    PickObstacle,
    PickPixel,
    PickTarget,
)
from labrig.errors import SafetyStopError, TargetMissedError, TrialsFailedError
from labrig.experiments.declared import PROTOCOL_MODELS, find_experiment
from labrig.experiments.insertion.ending import UNSURE_STOPS
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.result import InsertionResult
from labrig.experiments.registry import load_run_protocol
from labrig.protocol.load import load_protocol
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.reader import Run, open_run
from labrig.runner.conduct import Outcome, conduct
from labrig.runner.dialogue import Dialogue
from labrig.runner.session import Session
from labrig.steering.torsion import TorsionalLag
from tests.analysis.synthetic import NOW, PROVENANCE
from tests.devices.rigs import large_rig
from tests.runner.sessions import PROTOCOLS, RunBench, Told, Watched, bench, large_bench
from tests.runner.test_pausing import Asks, require_identical

Words = tuple[str, ...]
SHORT = ("target.position_mm=[0,-6,40]", "obstacles=[]", "roll_zero=null")
FROM_THE_BEGINNING = (
    "target.position_mm=[0,-3,25]", "obstacles=[]", "roll_zero.rolls=5", "roll_zero.length_mm=12",
    "insertion.frame_every_mm=3", "sheath.speed_mm_s=15",
)  # fmt: skip
"""A short insertion that first finds the roll zero; a record that begins so can be replayed."""
STRICT = ("target.position_mm=[0,-3,25]", "target.tolerance_mm=0.001")
LOSES = ("policy.most_misses=3", "sheath.origin=null")
EVEN = (
    "world.disturbances.heading_deg_per_root_mm=0",
    "world.disturbances.curvature_fraction=0",
    "world.sheath.lateral_play_sd_mm=0",
    "world.sheath.angle_play_sd_deg=0",
)


def insertion(*overrides: str) -> ExperimentProtocol:
    """Return a short insertion without obstacles, whose roll zero is already certified."""
    return load_protocol(PROTOCOLS / "insertion.yaml", PROTOCOL_MODELS, [*SHORT, *overrides])


@contextmanager
def open_certified_rig(
    tmp_path: Path, protocol: ExperimentProtocol, overrides: Sequence[str] = (), open_bench: Any = large_bench
) -> Iterator[RunBench]:
    """Open a rig with a mounted needle, referenced axes and a certified roll zero."""
    with open_bench(tmp_path, protocol, overrides) as opened:
        rig = opened.opened.rig
        opened.opened.hardware.world.mount_needle("N1")
        rig.enable()
        rig.reference_axes()
        rig.needle.certify_roll_zero(RollZero("N1", 0.0, 0.01, "before"))
        yield opened


def conduct_insertion(
    tmp_path: Path, protocol: ExperimentProtocol, overrides: Sequence[str] = EVEN
) -> tuple[Outcome, Run]:
    """Conduct an insertion."""
    with open_certified_rig(tmp_path, protocol, overrides) as opened:
        return opened.conduct(protocol)


class AsksInTissue(Asks):
    """Asks for a pause in tissue at the fourth step."""

    steps = 4

    def find(self, point: str) -> str | None:
        """Ask once."""
        self.steps -= point == self.point
        return super().find(point) if self.steps == 0 else None


def events(run: Run, kind: str) -> list[dict[str, Any]]:
    """Return the recorded events of one kind."""
    lines = (run.path / "events.jsonl").read_text(encoding="utf-8").splitlines()
    return [event for event in map(json.loads, lines) if event["kind"] == kind]


def truth(run: Run) -> dict[str, Any]:
    """Return the truth of the only insertion."""
    return json.loads((run.path / "truth.jsonl").read_text(encoding="utf-8").splitlines()[0])


def analyse(run: Run, *overrides: str) -> InsertionResult:
    """Analyse a run of insertions."""
    result = analyze_run(
        run, find_experiment("insertion"), overrides=overrides, workers=1, created=NOW, provenance=PROVENANCE
    )
    assert isinstance(result.content, InsertionResult)
    return result.content


@pytest.fixture(scope="module")
def arrived(tmp_path_factory: pytest.TempPathFactory) -> tuple[Outcome, Run]:
    """An insertion that reached its target."""
    return conduct_insertion(
        tmp_path_factory.mktemp("insertion"), insertion("target.position_mm=[0,-5.7,40]")
    )


@pytest.mark.processors
def test_the_target_is_reached_and_the_needle_withdrawn(arrived: tuple[Outcome, Run]) -> None:
    """In even gel the tip ends within 0.3 mm of the target, and every axis returns to zero."""
    outcome, run = arrived
    assert (outcome.exit_status, outcome.error) == ("success", None)
    assert truth(run)["true_target_error_mm"] < 0.3
    assert run.states.iloc[-1][["insertion_mm", "linear_mm"]].abs().max() < 0.05


def test_between_turns_the_needle_never_stops(arrived: tuple[Outcome, Run]) -> None:
    """The needle advances at the set speed except at turns of the bevel, the start and the end."""
    _, run = arrived
    stops_s = [flip["t_s"] for flip in events(run, "flip")]
    looks = events(run, "observation")
    for before, after in pairwise(looks):
        turned = any(before["t_s"] <= stop <= after["t_s"] for stop in stops_s)
        advanced_mm = after["depth_mm"] - before["depth_mm"]
        if not turned and after is not looks[-1] and before["depth_mm"] > 1.5 and advanced_mm > 0.5:
            assert advanced_mm / (after["t_s"] - before["t_s"]) == pytest.approx(1.0, abs=0.15)


@pytest.mark.processors
def test_frames_are_taken_every_millimetre_with_the_encoder_beside_them(arrived: tuple[Outcome, Run]) -> None:
    """Pictures are as far apart as policy and rig allow: the way to a turn is cut into n parts, n being rounded."""
    _, run = arrived
    protocol, rig = load_run_protocol(run), large_rig()
    assert isinstance(protocol, InsertionProtocol)
    every_mm = protocol.insertion.frame_every_mm
    passed_mm = protocol.insertion.speed_mm_s * (1 / rig.recording.state_rate_hz + 1 / rig.camera.rate_hz)
    window_mm = rig.axes.insertion.position_window
    frames = run.frame_table[run.frame_table["role"] == "observe"]
    depths = frames["insertion_mm"].to_numpy()
    assert np.diff(depths).max() < max(1.5 * every_mm + window_mm, 1.25 * every_mm + passed_mm)
    noted = {observation["frame"]: observation["depth_mm"] for observation in events(run, "observation")}
    assert all(noted[int(frame)] == depth for frame, depth in zip(frames["frame"], depths, strict=True))


def test_turns_are_half_turns_and_plans_say_why(arrived: tuple[Outcome, Run]) -> None:
    """No turn overshoots unless torsion was measured; plans are for start, sheath, schedule, deviation or nearness."""
    _, run = arrived
    for flip in events(run, "flip"):
        assert abs(flip["to_rad"] - flip["from_rad"]) == pytest.approx(math.pi)
        assert ("overshoot_rad" in flip, abs(flip["to_rad"]) < 13.0) == (False, True)
    plans = events(run, "plan")
    assert [plan["because"] for plan in plans[:2]] == ["start", "origin"]
    assert {plan["because"] for plan in plans[2:]} <= {"schedule", "deviation", "near"}
    assert all(plan["plan"]["found"] or plan["refusal"] for plan in plans)


def test_a_measured_torsion_is_overshot_and_returned(tmp_path: Path) -> None:
    """The rotation axis goes past each angle by the lag at that depth and back; the withdrawal ends at the zero."""
    protocol = insertion("target.position_mm=[0,3,25]")
    torsion = TorsionalLag(lag_rad=0.1, lag_rad_per_mm=0.01, best_sd_rad=0.02, per_mm_sd_rad=0.0)
    with open_certified_rig(tmp_path, protocol, EVEN, bench) as opened:
        opened.opened.rig.needle.certify_roll_zero(RollZero("N1", 0.0, 0.01, "before", torsion))
        _, run = opened.conduct(protocol)
    moves = [event for event in events(run, "move_done") if event["axis"] == "rotation"]
    assert [move["position"] for move in moves[:2]] == pytest.approx([0.1, 0.0], abs=0.002)
    flips = events(run, "flip")
    assert flips
    for flip in flips:
        assert abs(flip["overshoot_rad"]) == pytest.approx(0.1 + 0.01 * flip["depth_mm"], abs=0.001)
        past, back = [move["position"] for move in moves if move["t_s"] > flip["t_s"]][:2]
        assert past - flip["to_rad"] == pytest.approx(flip["overshoot_rad"], abs=0.002)
        assert back == pytest.approx(flip["to_rad"], abs=0.002)
    held_s = events(run, "hold")[0]["t_s"]
    ahead = {round(flip["from_rad"], 2) for flip in flips}
    assert {round(move["position"], 2) for move in moves if move["t_s"] > held_s} <= ahead


def test_axes_go_back_first_the_plan_is_shown_and_a_turn_waits_for_the_lag(tmp_path: Path) -> None:
    """Axes away from zero move there; a picture of the plan comes before the needle moves; a turn lasts the lag."""
    protocol = insertion("target.position_mm=[0,3,25]")
    with open_certified_rig(tmp_path, protocol, (*EVEN, "axes.rotation.lag_s=2"), bench) as opened:
        opened.session.move("linear", 3.0, 5.0)
        opened.session.move("insertion", 0.4, 1.0)
        rig, shown = opened.opened.rig, []

        def look(request: object) -> None:
            if isinstance(request, ConfirmPlan):
                shown.append((Path(request.picture).is_file(), rig.read_states()["insertion"].position))

        rig.operator = Watched(rig.operator, look)
        outcome, run = opened.conduct(protocol)
    assert (outcome.exit_status, shown) == ("success", [(True, 0.0)])
    turned_s = [event["t_s"] for event in events(run, "move_done") if event["axis"] == "rotation"]
    starts_s = [move["t_s"] for move in events(run, "move") if move["axis"] == "insertion"]
    flips_s = [flip["t_s"] for flip in events(run, "flip")]
    assert flips_s
    for flip in flips_s:
        done = next(t for t in turned_s if t > flip)
        assert next(t for t in starts_s if t > done) - done >= 2.0 - 1e-9


def test_a_plan_that_the_operator_declines_is_not_carried_out(tmp_path: Path) -> None:
    """If the operator declines, the run is aborted before the needle leaves the sheath."""
    with open_certified_rig(tmp_path, insertion(), EVEN) as opened:
        opened.opened.rig.operator = Watched(opened.opened.rig.operator, declines=ConfirmPlan)
        outcome, run = opened.conduct(insertion())
    assert (outcome.exit_status, isinstance(outcome.error, SafetyStopError)) == ("aborted", True)
    assert run.states["insertion_mm"].max() < 0.01


def test_a_needle_clamped_askew_arrives_once_its_zero_is_known(tmp_path: Path) -> None:
    """A needle clamped at 40 degrees has a roll zero of -40 degrees and reaches its target."""
    rolls = "roll_zero={specimen: {name: plain, gelatin_percent: 13}, rolls: 5}"
    protocol = insertion(rolls, "target.position_mm=[0,-5,40]")
    with large_bench(tmp_path, protocol, (*EVEN, "world.needle.clamp_roll_deg=40")) as opened:
        outcome, run = opened.conduct(protocol)
        known = opened.opened.rig.state.roll_zero
    assert known is not None
    assert math.degrees(known.zero_rad) == pytest.approx(-40.0, abs=0.5)
    assert (outcome.exit_status, truth(run)["true_target_error_mm"] < 0.5) == ("success", True)


@pytest.mark.parametrize(
    ("overrides", "world", "reason", "told", "deepest_mm"),
    [
        (STRICT, (), "target_missed", "0.001 mm are allowed", 40.0),
        (("needle.needle_id=N2",), EVEN, "no_roll_zero", "N2 has no certified roll zero", None),
        (("target.position_mm=[0,20,10]",), EVEN, "no_path", "turning circle", None),
        (LOSES, (*EVEN, "world.noise_sd=90"), "needle_lost", "3 sight", 5.0),
        ((), (*EVEN, "world.sheath_tip_at_origin_linear_mm=16"), "sheath_astray", "sheath slipped", 0.01),
    ],
)
def test_an_insertion_that_does_not_arrive_ends_with_its_reason_and_the_needle_out(
    tmp_path: Path, overrides: Words, world: Words, reason: str, told: str, deepest_mm: float | None
) -> None:
    """The run fails with exit code 1; a person is asked where nobody knows why; without a path nothing moves at all."""
    with open_certified_rig(tmp_path, insertion(*overrides), world) as opened:
        watched = opened.opened.rig.operator = Watched(opened.opened.rig.operator)
        outcome, run = opened.conduct(insertion(*overrides))
        assert opened.opened.rig.state.needle_in_tissue is False
    assert isinstance(outcome.error, TargetMissedError)
    assert (outcome.exit_status, outcome.reason, outcome.error.exit_code) == ("failed", reason, 1)
    assert told in outcome.error.message
    assert reason != "no_roll_zero" or "labrig run protocols/roll-zero.yaml" in outcome.error.hint
    doubts = [request.reason for request in watched.asked if isinstance(request, ConfirmStopped)]
    assert len(doubts) == (reason in UNSURE_STOPS)
    assert all(told in doubt for doubt in doubts)
    if deepest_mm is None:
        assert events(run, "move") == []
        return
    assert list(run.trials["stop"]) == [reason]
    assert analyse(run).insertions[0].as_recorded
    assert run.states["insertion_mm"].max() < deepest_mm
    assert run.states.iloc[-1][["insertion_mm", "linear_mm"]].abs().max() < 0.05
    assert (reason == "sheath_astray") != any(isinstance(request, ConfirmPlan) for request in watched.asked)


@pytest.mark.parametrize(
    ("override", "world", "told"),
    [
        ("repetitions=1", ("world.light.level=8", "world.light.glint=0"), "the picture is dark"),
        ("obstacles=[{ask: true, radius_mm: 1.5}]", (), "sees 0 marked obstacles"),
    ],
)
def test_what_the_camera_or_a_person_does_not_see_stops_the_insertion(
    tmp_path: Path, override: str, world: tuple[str, ...], told: str
) -> None:
    """A dark picture, and an obstacle that the simulated operator is asked for and the world lacks."""
    outcome, run = conduct_insertion(tmp_path, insertion(override), (*EVEN, *world))
    assert told in str(outcome.error)
    assert run.states["insertion_mm"].max() < 0.01


def test_the_path_starts_where_the_sheath_is_found(tmp_path: Path) -> None:
    """The path starts at the sheath's true pose, with its play of half a millimetre and a degree."""
    play = ("world.sheath.lateral_play_sd_mm=0.4", "world.sheath.angle_play_sd_deg=0.7")
    outcome, run = conduct_insertion(tmp_path, insertion("target.position_mm=[0,-3,25]"), (*EVEN[:2], *play))
    assert outcome.exit_status == "success"
    (origin,), plan = events(run, "origin"), events(run, "plan")[1]
    assert origin["accepted"]
    assert math.dist(origin["tip_mm"], truth(run)["sheath_tip_mm"]) < 0.05
    assert abs(origin["across_mm"]) > 0.1
    leans = np.diff(np.array(truth(run)["path_mm"])[:2, 1:], axis=0)[0]
    assert origin["heading_rad"] == pytest.approx(math.atan2(leans[0], leans[1]), abs=math.radians(0.3))
    y_mm, z_mm = origin["tip_mm"]
    assert plan["start_mm"][1:] == pytest.approx((y_mm, z_mm + 1.5), abs=0.1)
    drawn = run.frame_table[run.frame_table["role"] == "plan"]["frame"].iloc[-1]
    assert (np.abs(run.pictures[int(drawn)].astype(int) - (167, 121, 204)).max(axis=2) < 30).sum() > 30


def test_target_and_obstacles_may_be_picked_on_a_picture_and_the_replay_is_identical(tmp_path: Path) -> None:
    """A picked pixel becomes the target in the plane, others the obstacles that the protocol asks for, in its order."""
    asked = (
        "target={ask: true, tolerance_mm: 3}",
        "obstacles=[{position_mm: [0, 10, 20], radius_mm: 2}, {ask: true, radius_mm: 1.5}]",
    )
    protocol = load_protocol(PROTOCOLS / "insertion.yaml", PROTOCOL_MODELS, [*FROM_THE_BEGINNING, *asked])
    world = (*EVEN, "world.target_mark_mm=[-3,25]", "world.obstacle_marks_mm=[[6, 18, 1.5]]")
    with large_bench(tmp_path, protocol, world) as opened:
        watched = opened.opened.rig.operator = Watched(opened.opened.rig.operator)
        outcome, run = opened.conduct(protocol)
    assert outcome.exit_status == "success"
    target, obstacle = (request for request in watched.asked if isinstance(request, PickPixel))
    assert (type(target), type(obstacle)) == (PickTarget, PickObstacle)
    assert "number 1 of 1, 1.5 mm in radius" in obstacle.text
    assert events(run, "trial_start")[0]["target_mm"] == pytest.approx([0.0, -3.0, 25.0], abs=0.1)
    stated, picked = events(run, "trial_start")[0]["obstacles"]
    assert stated["position_mm"] == [0.0, 10.0, 20.0]
    assert picked["position_mm"] == pytest.approx([0.0, 6.0, 18.0], abs=0.1)
    assert picked["radius_mm"] == 1.5
    require_identical(run)


@dataclass
class MissesOnce:
    """Clicks a target out of the tissue first, and the right one afterwards."""

    operator: Operator
    has_missed: bool = False

    def ask(self, request: OperatorRequest, meanwhile: Callable[[], None], offer: Offer = NO_OFFER) -> Answer:
        """Answer."""
        if isinstance(request, PickTarget) and not self.has_missed:
            self.has_missed = True
            return Answer(confirmed=True, note="", pixel=(123.0, 30.0))
        return self.operator.ask(request, meanwhile, offer)


def test_a_wrongly_clicked_target_ends_its_insertion_and_not_the_run(tmp_path: Path) -> None:
    """The other insertion is made, every start has its stop, the run has failed for that reason, and is measured."""
    protocol = insertion("target={ask: true}", "specimen.width_mm=20", "repetitions=2")
    with open_certified_rig(tmp_path, protocol, (*EVEN, "world.target_mark_mm=[-3,25]"), bench) as opened:
        opened.opened.rig.operator = MissesOnce(opened.opened.rig.operator)
        outcome, run = opened.conduct(protocol)
    assert isinstance(outcome.error, TrialsFailedError)
    assert (outcome.exit_status, outcome.reason, outcome.error.exit_code) == ("failed", "no_target", 1)
    assert "1 of 2 insertions failed; no target: the target at y" in outcome.error.message
    assert list(run.trials["exit_status"]) == ["failed", "success"]
    first, second = analyse(run).insertions
    assert (first.stop, first.reached, second.reached) == ("no_target", False, True)


def test_a_pause_in_tissue_holds_where_the_needle_is_and_goes_on_to_the_target(tmp_path: Path) -> None:
    """The axes stop at the next step, nothing is withdrawn, the needle goes on, and the replay is identical."""
    asks = AsksInTissue("in_tissue")
    protocol = load_protocol(PROTOCOLS / "insertion.yaml", PROTOCOL_MODELS, FROM_THE_BEGINNING)
    with bench(tmp_path, protocol, EVEN) as opened:
        session = Session(opened.opened.rig, opened.recorder, Told(), Dialogue(asks))
        outcome = conduct(find_experiment("insertion"), protocol, session)
    run = open_run(opened.recorder.path)
    assert outcome.exit_status == "success"
    assert [type(request) for request in opened.opened.person.asked] == [Paused]
    (pause,), (goes_on,), looks = (events(run, kind) for kind in ("pause", "continue", "observation"))
    assert (pause["point"], pause["trial"]) == ("in_tissue", 0)
    moves = [move["t_s"] for move in events(run, "move") if move["axis"] == "insertion"]
    assert min(t_s for t_s in moves if t_s > pause["t_s"]) >= goes_on["t_s"]
    (stood,) = run.states[run.states["seq"].between(pause["seq"], goes_on["seq"])]["insertion_mm"]
    assert run.states[run.states["t_s"] > goes_on["t_s"]].iloc[0]["insertion_mm"] == pytest.approx(stood)
    passed = [look["depth_mm"] for look in looks if look["t_s"] <= pause["t_s"]]
    assert 0.0 <= stood - passed[-1] < 1.0
    assert looks[len(passed)]["depth_mm"] > stood
    assert "after this turn or step, axes hold then" in asks.told
    assert truth(run)["true_target_error_mm"] < 1.0
    require_identical(run)
