"""Section V-C of the paper: to a target between obstacles, the tip seen, its pose estimated, the path planned anew.

The needle advances at the set speed from one turn of the bevel to the next and is looked at on its way; gel relaxes
around a needle that stops. For a turn it stands: half a turn takes most of a second, and a bevel that comes round while
the needle advances at 1 mm/s leads it out of the plane by a degree, which one camera does not see. So the lag of the
bevel behind its drive, measured in the rig file (`axes.rotation.lag_s`), is waited for and not reckoned with: however
long it is, the turn acts where it was planned.

The path starts where the sheath's tip is found once it is in, in its direction. A sheath that stands elsewhere than
origin and linear encoder allow ends the insertion before the needle leaves it.
"""

import math
from dataclasses import dataclass, field

from labrig.analysis.origin import find_sheath
from labrig.analysis.result import TrialOrigin
from labrig.analysis.sentinel import GridRole
from labrig.devices.needle_state import RollZero
from labrig.devices.operator import ConfirmPlan, ConfirmStopped, PickTarget, PlacePhantom
from labrig.errors import FileFormatError, TargetMissedError
from labrig.experiments.insertion.aim import Aim, aim_of, aim_problems, obstacles_of
from labrig.experiments.insertion.events import (
    BevelTurn,
    InsertionRole,
    InsertionSheath,
    InsertionStart,
    InsertionStop,
    NeedleHeld,
    PathSought,
    RecordedEstimate,
    RecordedPose,
    TipObserved,
)
from labrig.experiments.insertion.plan import roll_zero_order, roll_zero_s
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.settings import insertion_settings, with_start
from labrig.experiments.shared.needle_events import NeedleRole
from labrig.experiments.shared.rig_view import load_tip_view, require_light
from labrig.experiments.shared.roll_zero_search import find_roll_zero
from labrig.runner.axis_positions import AxisPositions, axis_positions_of
from labrig.runner.graph_paper import confirm_needle_out, photograph_grid, require_same_grid
from labrig.runner.session import Session, TakenPicture
from labrig.runner.withdrawal import withdraw
from labrig.steering.planner import sample_path
from labrig.steering.policy import SteeringCommand, SteeringSettings, TipSighting
from labrig.steering.step import SteeringState, start_steering, step_steering
from labrig.steering.tip_search import TipSearched, TipView, find_tip
from labrig.vision.overlay import DrawnPlan, draw_plan
from labrig.vision.picture import Picture

_HOLD_S = 1.0
_SAME_MM = 0.005
_OFF_ZERO_MM = 0.05
_UNSURE = ("needle_lost", "needle_stuck", "sheath_astray")


def run(protocol: InsertionProtocol, session: Session) -> None:
    """Make every repetition.

    Raises
    ------
    TargetMissedError
        When one of them did not reach the target, after all of them have been made; or when there is no path.
    CalibrationRefusedError
        When grid pictures before and after them say that the camera was bumped.
    """
    view = load_tip_view(session.rig.description)
    before = photograph_grid(protocol.sentinel, GridRole.BEFORE, session)
    roll_zero = _certified_roll_zero(protocol, session)
    missed: list[SteeringCommand] = []
    for trial in range(protocol.repetitions):
        command = _insert_once(protocol, session, view, roll_zero, trial)
        missed += [command] if command.stop != "target_reached" else []
    after = photograph_grid(protocol.sentinel, GridRole.AFTER, session)
    require_same_grid(before, after, protocol.sentinel, view.plane)
    if missed:
        made = protocol.repetitions
        reason = missed[0].stop if missed[0].stop in _UNSURE else "target_missed"
        raise TargetMissedError(
            f"{made - len(missed)} of {made} insertions reached the target; {missed[0].stop}: {missed[0].detail}",
            "the report shows where the needle left its path",
            reason=str(reason),
        )


def _certified_roll_zero(protocol: InsertionProtocol, session: Session) -> RollZero:
    """Return the roll zero of the needle, found first where there is none and the protocol says how."""
    needle, rig = protocol.needle, session.rig
    known = rig.needle.roll_zero_of(needle.needle_id)
    if known is not None and all(axis.referenced for axis in rig.axes):
        confirm_needle_out(session)
        _go_to_the_start(protocol, session)
        return known
    if protocol.roll_zero is None:
        raise TargetMissedError(
            f"needle {needle.needle_id} has no certified roll zero as it is clamped now",
            "labrig run protocols/roll-zero.yaml finds it; or say how under roll_zero: in the protocol",
            reason="no_roll_zero",
        )
    return find_roll_zero(roll_zero_order(protocol, protocol.roll_zero), session)


def _go_to_the_start(protocol: InsertionProtocol, session: Session) -> None:
    """Draw needle and sheath back to zero where they stand elsewhere; no needle is in tissue."""
    states = session.rig.read_states()
    for axis, speed in (("insertion", protocol.insertion.speed_mm_s), ("linear", protocol.sheath.speed_mm_s)):
        if abs(states[axis].position) > _OFF_ZERO_MM:
            session.move(axis, 0.0, speed)


def _insert_once(
    protocol: InsertionProtocol, session: Session, view: TipView, roll_zero: RollZero, trial: int
) -> SteeringCommand:
    """Place the block, plan, let the operator look at it, insert, hold, withdraw; return the last command."""
    rig, sheath = session.rig, protocol.sheath
    session.progress(_done_s(protocol, trial, 0.0), f"insertion {trial + 1} of {protocol.repetitions}")
    aim = _aim(protocol, session, view, trial)
    settings = insertion_settings(protocol, aim.target_mm, aim.obstacles)
    state, command = start_steering(settings)
    insertion = _Insertion(protocol, session, view, roll_zero, trial, settings)
    insertion.record_start(aim, state)
    if command.stop is not None:
        raise TargetMissedError(
            f"there is no path: {command.detail}", "move target or obstacles", reason="no_path"
        )
    rig.needle.mark_in_tissue(session.recorder.run_name)
    session.move("rotation", roll_zero.zero_rad, rig.rotation.max_speed / 2)
    session.move("linear", sheath.depth_mm, sheath.speed_mm_s)
    insertion.path.append(axis_positions_of(rig.read_states()))
    picture = session.take_picture(InsertionRole.SCENE, trial)
    origin = insertion.find_sheath(picture)
    if origin is not None:
        state, command = insertion.start_from(origin, state)
    if command.stop is None:
        insertion.confirm(picture.image, aim, state, origin)
        state, command = _steer(insertion, state, command)
    rig.stop()
    insertion.finish(state, command)
    return command


def _steer(
    insertion: "_Insertion", state: SteeringState, command: SteeringCommand
) -> tuple[SteeringState, SteeringCommand]:
    """Turn, advance, look, find the tip, estimate and plan, until the step says stop: the whole closed loop."""
    while command.stop is None:
        insertion.turn_bevel(command.roll_rad)
        picture = insertion.advance(command)
        seen = insertion.find_tip(picture, state)
        inserted_mm = max(picture.positions.insertion_mm, state.insertion_mm)
        before = state
        state, command = step_steering(state, TipSighting(inserted_mm, seen.position_mm), insertion.settings)
        insertion.tell(picture, seen, before, state)
    return state, command


def _aim(protocol: InsertionProtocol, session: Session, view: TipView, trial: int) -> Aim:
    """Have the block placed, and return target and obstacles, the target asked for where the protocol says so."""
    specimen = protocol.specimen
    obstacles = tuple(
        (view.pixel_of(obstacle.position_mm), obstacle.radius_mm)
        for obstacle in obstacles_of(protocol, view.plane)
    )
    name = specimen.name if protocol.repetitions == 1 else f"{specimen.name} {trial + 1}"
    session.ask(PlacePhantom(name, specimen.gelatin_percent, obstacles))
    picked_px = None
    if protocol.target.ask:
        picture = session.take_picture(InsertionRole.TARGET, trial)
        picked_px = session.ask(PickTarget(str(session.picture_path(picture.frame)))).pixel
    aim = aim_of(protocol, view.plane, picked_px)
    if problems := tuple(aim_problems(protocol, aim, view.plane)):
        raise FileFormatError(problems)
    return aim


def _done_s(protocol: InsertionProtocol, trial: int, inserted_mm: float) -> float:
    """Return how much of the estimate is behind [s]."""
    speed_mm_s = protocol.insertion.speed_mm_s
    return roll_zero_s(protocol) + (trial * protocol.insertion.max_length_mm + inserted_mm) / speed_mm_s


@dataclass
class _Insertion:
    """One insertion while it goes on: what it is made of, and where the needle has been."""

    protocol: InsertionProtocol
    session: Session
    view: TipView
    roll_zero: RollZero
    trial: int
    settings: SteeringSettings
    path: list[AxisPositions] = field(default_factory=list)
    bevel_rad: float = 0.0
    run_to_mm: float = 0.0

    def turn_bevel(self, roll_rad: float) -> None:
        """Turn the bevel by half a turn, the needle standing, whichever way keeps it nearer to where it began."""
        if roll_rad == 0.0:
            return
        rotation = self.session.rig.rotation
        from_rad = self.roll_zero.zero_rad + self.bevel_rad
        self.bevel_rad += -abs(roll_rad) if self.bevel_rad > 0.0 else abs(roll_rad)
        to_rad = self.roll_zero.zero_rad + self.bevel_rad
        depth_mm = self.path[-1].insertion_mm
        self.session.record(BevelTurn(trial=self.trial, depth_mm=depth_mm, from_rad=from_rad, to_rad=to_rad))
        self.session.move("rotation", to_rad, rotation.nearest_speed(rotation.max_speed))
        self.session.rig.wait(rotation.lag_s)
        self.path.append(axis_positions_of(self.session.rig.read_states()))

    def advance(self, command: SteeringCommand) -> TakenPicture:
        """Run on at the set speed, without a stop where the needle runs already, and look at the place commanded."""
        if abs(command.run_to_mm - self.run_to_mm) > _SAME_MM:
            self.session.start("insertion", command.run_to_mm, self.protocol.insertion.speed_mm_s)
            self.run_to_mm = command.run_to_mm
        there = False
        while not there:
            states = self.session.record_next_states()
            self.path.append(axis_positions_of(states))
            passing = command.run_to_mm - command.observe_at_mm > _SAME_MM
            there = states["insertion"].target_reached or (
                passing and self.path[-1].insertion_mm >= command.observe_at_mm
            )
        return self.session.take_picture(NeedleRole.OBSERVE, self.trial)

    def find_tip(self, picture: TakenPicture, state: SteeringState) -> TipSearched:
        """Look for the tip in a picture, where the last state expects it."""
        require_light(picture.image)
        inserted_mm = max(picture.positions.insertion_mm, state.insertion_mm)
        expected = state.predict(inserted_mm, self.settings)
        return find_tip(self.view, picture.image, expected, state.tip, self.bevel_rad)

    def find_sheath(self, picture: TakenPicture) -> TrialOrigin | None:
        """Find where the sheath stands before the needle leaves it, and write it down; None where that is not asked."""
        sheath = self.protocol.sheath
        if sheath.origin is None:
            return None
        require_light(picture.image)
        linear_mm = picture.positions.linear_mm
        origin = find_sheath(
            picture.image, self.view.plane, sheath, linear_mm, trial=self.trial, frame=picture.frame
        )
        self.session.record(InsertionSheath(origin=origin))
        return origin

    def start_from(self, origin: TrialOrigin, state: SteeringState) -> tuple[SteeringState, SteeringCommand]:
        """Plan anew from where the sheath was found; stop before the needle leaves a sheath that stands elsewhere."""
        if not origin.accepted or origin.tip_mm is None or origin.heading_rad is None:
            return state, SteeringCommand(0.0, 0.0, 0.0, "sheath_astray", (origin.reason or "").rstrip("."))
        self.settings = with_start(self.settings, origin.tip_mm, origin.heading_rad)
        state, command = start_steering(self.settings)
        self._record_plan(state, origin.frame, because="origin")
        return state, command

    def confirm(
        self, image: Picture, aim: Aim, state: SteeringState, origin: TrialOrigin | None = None
    ) -> None:
        """Draw plan, obstacles, axes and the sheath that was found into the picture, and wait for a yes."""
        problem = self.settings.problem
        drawn = DrawnPlan(
            path_mm=sample_path(problem, state.plan)[:, 1:],
            target_mm=aim.target_mm[1:],
            tolerance_mm=problem.tolerance_mm,
            obstacles=tuple((obstacle.position_mm[1:], obstacle.radius_mm) for obstacle in aim.obstacles),
            sheath=None
            if origin is None or origin.tip_mm is None
            else (origin.tip_mm, origin.heading_rad or 0.0),
        )
        file = self.session.draw(draw_plan(image, self.view.plane, drawn), InsertionRole.PLAN, self.trial)
        arcs = len(state.plan.arcs)
        plan = f"{arcs} {'arc' if arcs == 1 else 'arcs'}, {state.plan.length_mm or 0.0:.0f} mm"
        self.session.ask(ConfirmPlan(str(file), self.view.pixel_of(aim.target_mm), plan))

    def finish(self, state: SteeringState, command: SteeringCommand) -> None:
        """Hold, take the last picture, write down what is true, and withdraw along the path."""
        session, protocol = self.session, self.protocol
        session.record(NeedleHeld(trial=self.trial, stop=command.stop, detail=command.detail))
        session.rig.wait(_HOLD_S)
        final_frame = session.take_picture(NeedleRole.FINAL, self.trial).frame
        for line in session.rig.truth():
            session.recorder.truth(trial=self.trial, **line)
        session.progress(
            _done_s(protocol, self.trial, state.insertion_mm), f"{command.stop}: {command.detail}"
        )
        if command.stop in _UNSURE:
            session.ask(ConfirmStopped(command.detail))
        speeds = {
            "insertion": protocol.insertion.withdraw_speed_mm_s,
            "rotation": session.rig.rotation.max_speed / 2,
            "linear": protocol.sheath.speed_mm_s,
        }
        withdraw(session, self.path, speeds)
        reached = command.stop == "target_reached"
        session.record(
            InsertionStop(
                trial=self.trial,
                exit_status="success" if reached else "failed",
                outcome="reached" if reached else "stopped" if command.stop in _UNSURE else "missed",
                stop=command.stop,
                cause=command.detail,
                final_frame=final_frame,
                depth_mm=state.insertion_mm,
                replans=state.replans,
            )
        )

    def record_start(self, aim: Aim, state: SteeringState) -> None:
        """Append what is aimed at, and the first plan."""
        specimen, needle = self.protocol.specimen, self.protocol.needle
        self.session.record(
            InsertionStart(
                trial=self.trial,
                specimen=specimen.name,
                gelatin_percent=specimen.gelatin_percent,
                hole=0,
                hole_position_mm=0.0,
                needle_id=needle.needle_id,
                target_mm=aim.target_mm,
                tolerance_mm=self.settings.problem.tolerance_mm,
                obstacles=aim.obstacles,
                start_mm=(0.0, 0.0, 0.0),
                start_heading_rad=0.0,
                roll_zero_rad=self.roll_zero.zero_rad,
                roll_zero_sd_rad=self.roll_zero.sd_rad,
            )
        )
        self._record_plan(state, None)

    def tell(
        self, picture: TakenPicture, seen: TipSearched, before: SteeringState, state: SteeringState
    ) -> None:
        """Append what was seen and estimated, and the plan where one was sought."""
        tip, fix, inserted_mm = state.tip, seen.fix, state.insertion_mm
        innovation_mm = None
        if seen.position_mm is not None:
            expected_mm = before.predict(inserted_mm, self.settings)[:3, 3]
            innovation_mm = (seen.position_mm - expected_mm).tolist()
        self.session.record(
            TipObserved(
                trial=self.trial,
                frame=picture.frame,
                depth_mm=inserted_mm,
                step_mm=inserted_mm - before.insertion_mm,
                bevel_rad=self.bevel_rad,
                accepted=fix.accepted,
                reason=fix.reason,
                tip_px=fix.tip_px,
                heading_rad=seen.heading_rad,
                score=fix.score,
                distinctness=fix.distinctness,
                seen_heading_rad=fix.heading_rad,
                near_px=seen.near_px,
                region_px=seen.region_px,
                tip_mm=None if seen.position_mm is None else seen.position_mm.tolist(),
                estimate=RecordedEstimate(
                    position_mm=tip.position_mm.tolist(),
                    heading_rad=tip.heading_rad,
                    position_sd_mm=tip.position_sd_mm,
                    heading_sd_rad=tip.heading_sd_rad,
                    radius_mm=1.0 / tip.curvature if tip.curvature else None,
                ),
                innovation_mm=innovation_mm,
                nis=tip.nis,
                believed=tip.accepted,
                misses=tip.misses,
            )
        )
        if state.why is not None:
            self._record_plan(state, picture.frame)
        self.session.progress(
            _done_s(self.protocol, self.trial, inserted_mm), f"inserted {inserted_mm:.0f} mm"
        )

    def _record_plan(self, state: SteeringState, frame: int | None, because: str | None = None) -> None:
        pose = state.plan_start
        self.session.record(
            PathSought(
                trial=self.trial,
                frame=frame,
                depth_mm=state.insertion_mm,
                because=because or str(state.why),
                refusal=state.refusal,
                replans=state.replans,
                from_mm=state.plan_from_mm,
                start=RecordedPose(
                    position_mm=pose[:3, 3].tolist(),
                    heading_rad=math.atan2(pose[1, 2], pose[2, 2]),
                    rotation=pose[:3, :3].tolist(),
                ),
                **vars(state.plan),
            )
        )
