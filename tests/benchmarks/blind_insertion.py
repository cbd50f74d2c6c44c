"""One insertion in a drawn world without pictures: the product's loop, with a camera that sees with drawn noise.

A sighting is where the tip appears in the steering plane, with its parallax, and noise. The target is tracked if it
moves: its place is told with noise, as that of the tip.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from labrig.devices.axis_description import AXES as AXIS_NAMES
from labrig.devices.needle_state import RigState, RollZero
from labrig.experiments.insertion.aim import Aim
from labrig.experiments.insertion.bevel import Bevel
from labrig.experiments.insertion.events import InsertionStop
from labrig.experiments.insertion.procedure import Insertion
from labrig.experiments.insertion.procedure import steer as run_loop
from labrig.experiments.insertion.protocol import InsertionProtocol, OutOfPlane
from labrig.experiments.insertion.settings import make_insertion_settings
from labrig.needle.kinematics import FloatArray
from labrig.protocol.conditions import Condition
from labrig.runner.session import Session, TrialRun
from labrig.runner.sight import TakenPicture
from labrig.runner.trials import Trial
from labrig.runner.virtual_rig import EventList, VirtualRig
from labrig.runner.virtual_sight import WorldSight
from labrig.simulation.lens import see_points
from labrig.simulation.world import Glance
from labrig.steering.parameters import PAPER_POLICY, Turning
from labrig.steering.policy import SteeringSettings
from labrig.steering.problem import PlanProblem
from labrig.steering.step import start_steering
from labrig.steering.torsion import TorsionalLag
from tests.benchmarks.virtual import load_plane, read_simulated_rig
from tests.benchmarks.worlds import DrawnWorld, read_protocol

Policy = Literal["default", "paper"]

TARGET_SD_MM = 0.2  # of a tracked target


@dataclass(frozen=True)
class InsertionEnd:
    """The end of an insertion: why it stopped, the world's truth about it, and what the policy says of it.

    `off_mm` is the tip's true place (x, y, z) from the target; `interval_mm` is the policy's interval of its length;
    `left_plane` says that the picture contradicted what was known of the depth.
    """

    stop: str
    off_mm: tuple[float, float, float]
    clearance_mm: float
    replans: int
    turns: int
    outcome: str
    interval_mm: tuple[float, float]
    left_plane: bool

    @property
    def error_mm(self) -> float:
        """The distance from the target in space."""
        return math.hypot(*self.off_mm)

    @property
    def in_plane_mm(self) -> float:
        """The distance from the target in the plane."""
        return math.hypot(*self.off_mm[1:])

    @property
    def out_of_plane_mm(self) -> float:
        """The distance from the target across the plane."""
        return abs(self.off_mm[0])


class _DrawnSight(WorldSight):
    """Sees the tip of a drawn world where perspective puts it, with its noise."""

    drawn: DrawnWorld

    def see_tip(self, glance: Glance | None, base_rad: float) -> FloatArray | None:
        """Return where the tip is seen, (3,)."""
        del glance, base_rad
        return _see(self.drawn, self.drawn.world.tip_mm(), self.drawn.sighting_sd_mm)

    def locate(self, points_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where points (N, 3) appear, by a map that is exact."""
        return see_points(points_mm, self.drawn.world.description.lens)


class _DrawnInsertion(Insertion):
    """An insertion whose target is tracked where it moves: its place is told with noise, as that of the tip."""

    drawn: DrawnWorld

    def follow_markers(self, picture: TakenPicture, inserted_mm: float) -> None:
        """Move the target to where it is tracked."""
        del picture, inserted_mm
        target_mm = self.drawn.world.locate_target_mm()
        if self.drawn.world.description.target_moves_mm and target_mm is not None:
            x, y, z = _see(self.drawn, target_mm, TARGET_SD_MM).tolist()
            self.settings = replace(
                self.settings, problem=replace(self.settings.problem, target_mm=(x, y, z))
            )


def make_settings(problem: PlanProblem, policy: Policy) -> SteeringSettings:
    """Return the settings of a policy, which are the same in every world: the protocol's, or the paper's.

    Only the longest path is the problem's: its targets are deeper than the protocol's.
    """
    chosen = make_insertion_settings(read_protocol(), problem.target_mm, problem.obstacles)
    chosen = replace(chosen, problem=replace(chosen.problem, max_length_mm=problem.max_length_mm))
    if policy == "default":
        return chosen
    papers = {"method": "paper", "radius_sd_mm": 0.0, "cavity_every_mm": None, "slip_sd": 0.0}
    estimator = chosen.estimator.model_copy(update=papers)
    return replace(chosen, estimator=estimator, policy=PAPER_POLICY, method="paper")


def insert(drawn: DrawnWorld, policy: Policy) -> InsertionEnd:
    """Carry out an insertion; the paper's policy turns back and forth, and the default compensates."""
    settings = make_settings(drawn.problem, policy)
    record = EventList()
    session = _open_session(drawn, record)
    made = _make_insertion(drawn, settings, "back_and_forth" if policy == "paper" else "compensated", session)
    made.bevel.centre()
    session.move("linear", drawn.linear_mm, 10.0)
    made.path.append(session.read_positions())
    state, command = run_loop(made, *start_steering(settings))
    ending = made.finish(state, command)
    stop = next(event for event in record.events if isinstance(event, InsertionStop))
    truth: Any = drawn.world.truth()
    x_mm, y_mm, z_mm = (np.array((truth["tip_x_mm"], *truth["tip_mm"])) - truth["target_mm"]).tolist()
    bounds = made.bounds
    assert stop.interval_mm is not None
    assert bounds is not None
    return InsertionEnd(
        stop=str(command.stop),
        off_mm=(x_mm, y_mm, z_mm),
        clearance_mm=float(truth["true_min_clearance_mm"]),
        replans=state.replans,
        turns=len(made.bevel.turns),
        outcome=ending.outcome,
        interval_mm=stop.interval_mm,
        left_plane=bounds.depth is not None and bounds.depth.contradicts,
    )


def _open_session(drawn: DrawnWorld, record: EventList) -> Session:
    """Return a session on a virtual rig whose world is drawn."""
    state = RigState(needle_in_tissue=False, referenced=AXIS_NAMES)
    rig = VirtualRig(read_simulated_rig(), drawn.world, state, 0.0)
    session = Session(rig, record, lambda _done, _doing: None)
    # The bounds are told of every end, however it came about.
    session.dialogue.conditions = (Condition(value="target_error_mm", above=1e6),)
    return session


def _make_insertion(
    drawn: DrawnWorld, settings: SteeringSettings, turning: Turning, session: Session
) -> _DrawnInsertion:
    """Return the insertion before it begins."""
    sight = _DrawnSight(drawn.world, load_plane(), drawn.noise, None)
    sight.drawn = drawn
    session.dialogue.starts_itself = True
    trial = TrialRun(session, Trial(0, 0))
    lag = drawn.measured_lag
    torsion = None
    if lag != TorsionalLag():
        torsion = replace(drawn.told.lag, lag_rad=lag.lag_rad, lag_rad_per_mm=lag.lag_rad_per_mm)
    roll_zero = RollZero("N1", drawn.roll_zero_rad, drawn.told.roll_zero_sd_rad, "", torsion)
    made = _DrawnInsertion(_tell(drawn), session, sight, roll_zero, trial)
    made.drawn, made.settings = drawn, settings
    made.aim = Aim(settings.problem.target_mm, settings.problem.obstacles)
    made.bevel = Bevel(session, 0, roll_zero, turning, settings.problem.radius_mm)
    return made


def _tell(drawn: DrawnWorld) -> InsertionProtocol:
    """Return the protocol with what the policy is told of the ways out of the plane."""
    told, protocol = drawn.told, read_protocol()
    unseen = OutOfPlane(
        heading_sd_deg_per_root_mm=math.degrees(told.heading_sd_rad_per_root_mm),
        start_sd_mm=told.start_sd_mm,
        start_sd_deg=math.degrees(told.start_sd_rad),
        lag_sd_deg=math.degrees(told.lag.best_sd_rad),
    )
    target_sd_mm = TARGET_SD_MM if drawn.world.description.target_moves_mm else 0.0
    target = protocol.target.model_copy(update={"sd_mm": target_sd_mm})
    return protocol.model_copy(update={"out_of_plane": unseen, "target": target})


def _see(drawn: DrawnWorld, place_mm: Sequence[float], sd_mm: float) -> FloatArray:
    """Return where a place appears in the plane, with noise, (3,)."""
    seen, _ = see_points(np.array([place_mm]), drawn.world.description.lens)
    return np.array((0.0, *(seen[0] + drawn.noise.normal(0.0, sd_mm, 2))))
