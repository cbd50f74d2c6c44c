"""Insertions in drawn worlds without pictures: the product's loop, with a camera that sees with drawn noise.

No world has the numbers that the policy assumes. It is read from its rig file. What protocols/insertion.yaml assumes a
value for is drawn about that value: radius, backlash, closing length, spacing of cavities, noise of the sightings. The
rig file's disturbances and torsion are drawn too. A sighting is where the tip appears in the steering plane, with its
parallax, and noise. The target is tracked if it moves: its place is told with noise, as that of the tip.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Literal

import numpy as np

from labrig.devices.axis_description import AXES as AXIS_NAMES
from labrig.devices.needle_state import RigState, RollZero
from labrig.devices.rig_file import load_rig
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
from labrig.simulation.description import GelDescription, WorldDescription
from labrig.simulation.gel import Ball
from labrig.simulation.lens import see_points
from labrig.simulation.world import Glance, World
from labrig.steering.parameters import PAPER_POLICY, Turning
from labrig.steering.policy import SteeringSettings
from labrig.steering.problem import PlanProblem
from labrig.steering.step import start_steering
from labrig.steering.torsion import TorsionalLag
from tests.benchmarks.planning_problems import draw_planar_problem
from tests.benchmarks.virtual import RIG, ROOT, load_plane, read_policy

Policy = Literal["default", "paper"]

GELATIN_PERCENT = 16.0
REACH_MM = 100.0
TARGET_SD_MM = 0.2  # of a tracked target
ROLL_ZERO_SD_RAD, LAG_SD_RAD = math.radians(0.5), math.radians(1.0)  # as they are measured
SPREADS = {
    "radius": 0.02, "backlash": 0.3, "closing": 0.3, "cavity_spacing": 0.5, "sighting": 0.3, "wander": 0.2,
    "torsion": 0.3,
}  # fmt: skip
"""Standard deviations of the logarithm of each value about the assumed one."""
_SMALL_PX = 64  # pictures are not taken; only the place of the lens counts


@dataclass(frozen=True)
class InsertionEnd:
    """The end of an insertion: why it stopped, the world's truth about it, and what the policy says of it.

    `off_mm` is the tip's true place (x, y, z) from the target; `interval_mm` is the policy's interval of its length.
    """

    stop: str
    off_mm: tuple[float, float, float]
    clearance_mm: float
    turns: int
    outcome: str
    interval_mm: tuple[float, float]


@dataclass(frozen=True)
class DrawnWorld:
    """A world with a phantom, an aimed target and the sheath introduced.

    problem : target and obstacles as the policy is told; sighting_sd_mm : noise of a sighting in y and z;
    roll_zero_rad : by how much the bevel is off where the policy takes it to be; torsion, unseen : what it knows of
    torsion and of other ways out of the plane; noise : draws the sightings.
    """

    world: World
    problem: PlanProblem
    sighting_sd_mm: float
    roll_zero_rad: float
    torsion: TorsionalLag | None
    unseen: OutOfPlane
    noise: np.random.Generator

    def see(self, place_mm: Sequence[float], sd_mm: float) -> FloatArray:
        """Return where a place appears in the plane, with noise, (3,)."""
        seen, _ = see_points(np.array([place_mm]), self.world.description.lens)
        return np.array((0.0, *(seen[0] + self.noise.normal(0.0, sd_mm, 2))))


@cache
def read_world(name: str) -> WorldDescription:
    """Return the world of `calibration/rig-NAME.yaml`."""
    world = load_rig(ROOT / "calibration" / f"rig-{name}.yaml").world
    assert world is not None
    return world


def draw_world(described: WorldDescription, seed: int) -> DrawnWorld:
    """Return the world of a seed, drawn about what the policy assumes.

    The lag was measured with an error that is the same at every depth; of the other ways out of the plane the policy is
    told the values of the rig file, not those drawn about them.
    """
    random = np.random.default_rng([seed, 5])
    problem = draw_planar_problem(np.random.default_rng([2, seed]), 2)
    description = _draw_description(described, random)
    world = World(description, seed)
    world.mount_needle("N1")
    balls = [Ball(obstacle.position_mm, obstacle.radius_mm) for obstacle in problem.obstacles]
    world.place_phantom("phantom", GELATIN_PERCENT, balls)
    world.aim_at(problem.target_mm)
    sighting_sd_mm = _draw_about(read_policy().estimator.observation_sd_mm, "sighting", random)
    roll_zero_rad, lag_error_rad = np.multiply(
        (ROLL_ZERO_SD_RAD, LAG_SD_RAD), random.standard_normal(2)
    ).tolist()
    needle, torsion = description.needle, None
    if needle.torsion_lag_deg + needle.torsion_lag_deg_per_mm > 0.0:
        lag_rad = math.radians(needle.torsion_lag_deg) + lag_error_rad
        lag_rad_per_mm = math.radians(needle.torsion_lag_deg_per_mm)
        torsion = TorsionalLag(lag_rad, lag_rad_per_mm, best_sd_rad=LAG_SD_RAD, per_mm_sd_rad=0.0)
    unseen = OutOfPlane(
        heading_sd_deg_per_root_mm=described.disturbances.out_of_plane_deg_per_root_mm,
        start_sd_mm=described.sheath.x_play_sd_mm,
        start_sd_deg=described.sheath.lean_play_sd_deg,
        lag_sd_deg=math.degrees(LAG_SD_RAD) if torsion else 0.0,
    )
    noise = np.random.default_rng([seed, 3])
    return DrawnWorld(world, problem, sighting_sd_mm, roll_zero_rad, torsion, unseen, noise)


def _draw_description(described: WorldDescription, random: np.random.Generator) -> WorldDescription:
    assumed, disturbances = read_policy(), described.disturbances
    torsion = _draw_about(1.0, "torsion", random)
    needle = {
        "torsion_lag_deg": torsion * described.needle.torsion_lag_deg,
        "torsion_lag_deg_per_mm": torsion * described.needle.torsion_lag_deg_per_mm,
        "backlash_mm": _draw_about(assumed.policy.backlash_mm, "backlash", random),
        "hinge_closing_mm": _draw_about(assumed.policy.closing_mm, "closing", random),
    }
    radius_mm = _draw_about(assumed.planner.radius_mm, "radius", random)
    every_mm = _draw_about(assumed.estimator.cavity_every_mm or math.inf, "cavity_spacing", random)
    cavities = min(int(random.poisson(REACH_MM / every_mm)), 20) if disturbances.cavities else 0
    wander = _draw_about(1.0, "wander", random)
    wanders = ("heading_deg_per_root_mm", "out_of_plane_deg_per_root_mm", "curvature_fraction")
    drawn = {name: wander * getattr(disturbances, name) for name in wanders}
    return described.model_copy(
        update={
            "gels": (GelDescription(gelatin_percent=GELATIN_PERCENT, radius_mean_mm=radius_mm, radius_sd_mm=0.0),),
            "needle": described.needle.model_copy(update=needle),
            "disturbances": disturbances.model_copy(update={"cavities": cavities, **drawn}),
            "lens": described.lens.model_copy(update={"width_px": _SMALL_PX, "height_px": _SMALL_PX}),
            "bubbles_per_specimen": 0,
        }
    )  # fmt: skip


def _draw_about(value: float, what: str, random: np.random.Generator) -> float:
    return float(value * math.exp(SPREADS[what] * random.standard_normal()))


class _DrawnSight(WorldSight):
    """Sees the tip of a drawn world where perspective puts it, with its noise."""

    drawn: DrawnWorld

    def see_tip(self, glance: Glance | None, base_rad: float) -> FloatArray | None:
        """Return where the tip is seen, (3,)."""
        del glance, base_rad
        return self.drawn.see(self.drawn.world.tip_mm(), self.drawn.sighting_sd_mm)

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
            x, y, z = self.drawn.see(target_mm, TARGET_SD_MM).tolist()
            problem = replace(self.settings.problem, target_mm=(x, y, z))
            self.settings = replace(self.settings, problem=problem)


def _make_settings(problem: PlanProblem, policy: Policy) -> SteeringSettings:
    """Return the settings of a policy, which are the same in every world: the protocol's, or the paper's.

    Only the longest path is the problem's: its targets are deeper than the protocol's.
    """
    chosen = make_insertion_settings(read_policy(), problem.target_mm, problem.obstacles)
    chosen = replace(chosen, problem=replace(chosen.problem, max_length_mm=problem.max_length_mm))
    if policy == "default":
        return chosen
    papers = {"method": "paper", "radius_sd_mm": 0.0, "cavity_every_mm": None, "slip_sd": 0.0}
    estimator = chosen.estimator.model_copy(update=papers)
    return replace(chosen, estimator=estimator, policy=PAPER_POLICY, method="paper")


def insert(drawn: DrawnWorld, policy: Policy) -> InsertionEnd:
    """Carry out an insertion; the paper's policy turns back and forth, and the default compensates."""
    world, record = drawn.world, EventList()
    made = _make_insertion(drawn, policy, record)
    made.bevel.centre()
    made.session.move("linear", world.description.sheath_tip_at_origin_linear_mm, 10.0)
    made.path.append(made.session.read_positions())
    state, command = run_loop(made, *start_steering(made.settings))
    ending = made.finish(state, command)
    stop = next(event for event in record.events if isinstance(event, InsertionStop))
    truth: Any = world.truth()
    x_mm, y_mm, z_mm = (np.array((truth["tip_x_mm"], *truth["tip_mm"])) - truth["target_mm"]).tolist()
    assert stop.interval_mm is not None
    return InsertionEnd(
        stop=str(command.stop), off_mm=(x_mm, y_mm, z_mm), clearance_mm=float(truth["true_min_clearance_mm"]),
        turns=len(made.bevel.turns), outcome=ending.outcome, interval_mm=stop.interval_mm,
    )  # fmt: skip


def _make_insertion(drawn: DrawnWorld, policy: Policy, record: EventList) -> _DrawnInsertion:
    """Return the insertion on a virtual rig, before it begins."""
    state = RigState(needle_in_tissue=False, referenced=AXIS_NAMES)
    rig = VirtualRig(load_rig(RIG, ["axes.insertion.limits=[-2, 200]"]), drawn.world, state, 0.0)
    session = Session(rig, record, lambda _done, _doing: None)
    # The bounds are told of every end, however it came about.
    session.dialogue.conditions = (Condition(value="target_error_mm", above=1e6),)
    session.dialogue.starts_itself = True
    sight = _DrawnSight(drawn.world, load_plane(), drawn.noise, None)
    roll_zero = RollZero("N1", drawn.roll_zero_rad, ROLL_ZERO_SD_RAD, "", drawn.torsion)
    made = _DrawnInsertion(_tell(drawn), session, sight, roll_zero, TrialRun(session, Trial(0, 0)))
    made.drawn = sight.drawn = drawn
    made.settings = settings = _make_settings(drawn.problem, policy)
    made.aim = Aim(settings.problem.target_mm, settings.problem.obstacles)
    turning: Turning = "back_and_forth" if policy == "paper" else "compensated"
    made.bevel = Bevel(session, 0, roll_zero, turning, settings.problem.radius_mm)
    return made


def _tell(drawn: DrawnWorld) -> InsertionProtocol:
    """Return the protocol with what the policy is told of the ways out of the plane."""
    protocol = read_policy()
    target_sd_mm = TARGET_SD_MM if drawn.world.description.target_moves_mm else 0.0
    target = protocol.target.model_copy(update={"sd_mm": target_sd_mm})
    return protocol.model_copy(update={"out_of_plane": drawn.unseen, "target": target})
