"""Section V-C of the paper: steer to a target between obstacles; observe the tip, estimate its pose, replan the path.

The needle advances at the set speed from one turn of the bevel to the next, and pictures are taken while it moves,
because gel relaxes around a needle that stops. It stops for a turn: half a turn takes most of a second, and a bevel
that turns while the needle advances at 1 mm/s leads it out of the plane by a degree, which one camera does not see. The
bevel lags behind its drive by the time in the rig file (`axes.rotation.lag_s`). The procedure waits for that time, so
that the turn acts where it was planned, however long the lag. Waiting does not help against torsion: directions and
overshoots do, see `steering.torsion`.

The path starts at the sheath's tip, in the sheath's direction, as found in a picture once the sheath is in. If the
sheath stands elsewhere than origin and linear encoder allow, the insertion ends before the needle leaves it.

A needle that was steered to the target is measured in the last picture, and `ending` decides whether it is there in
space too.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial

import numpy as np

from labrig.analysis.result import TrialOrigin
from labrig.analysis.sentinel import GridRole
from labrig.devices.axis_positions import AxisPositions, collect_axis_positions
from labrig.devices.needle_state import RollZero
from labrig.devices.operator import ConfirmPlan, ConfirmStopped, PickObstacle, PickTarget, PlacePhantom
from labrig.errors import FileFormatError, MeasurementRefusedError, TargetMissedError
from labrig.experiments.insertion.aim import Aim, Pixel, find_aim_problems, locate_place, make_aim
from labrig.experiments.insertion.bevel import Bevel
from labrig.experiments.insertion.ending import (
    UNSURE_STOPS,
    Ending,
    EstimatedEnd,
    TargetErrorBounds,
    decide_ending,
    judge_end,
    trace_path,
)
from labrig.experiments.insertion.events import (
    InsertionRole,
    InsertionSheath,
    InsertionStart,
    InsertionStop,
    NeedleHeld,
    PathSought,
    TipObserved,
    describe_sighting,
)
from labrig.experiments.insertion.foresight import find_place_problems, find_problems
from labrig.experiments.insertion.markers import FollowedMarkers, find_target_sd_mm, list_marker_ids
from labrig.experiments.insertion.protocol import InsertionObstacle, InsertionProtocol
from labrig.experiments.insertion.settings import (
    SAME_MM,
    make_insertion_settings,
    make_out_of_plane,
    start_at,
)
from labrig.experiments.shared.needle_events import NeedleRole
from labrig.experiments.shared.roll_zero_search import find_roll_zero
from labrig.needle.kinematics import FloatArray
from labrig.runner.graph_paper import photograph_grid, require_same_grid
from labrig.runner.session import Session, TrialRun
from labrig.runner.sight import Sight, TakenPicture
from labrig.runner.withdrawal import confirm_needle_out, find_speeds, withdraw
from labrig.steering.planner import sample_path
from labrig.steering.policy import Halt, SteeringCommand, SteeringSettings, TipSighting
from labrig.steering.state import SteeringState
from labrig.steering.step import start_steering, step_steering
from labrig.steering.tip import TipState
from labrig.steering.tip_search import TipSearched
from labrig.steering.torsion import RolledStretch
from labrig.vision.drawing import DrawnPlan, draw_plan
from labrig.vision.shaft_tip import READ_PX, ShaftTip

IN_TISSUE = "in_tissue"
"""The safe point between two steps on the way to the target, as the record names it: the axes stop, and hold."""

_HOLD_S = 1.0
_OFF_ZERO_MM = 0.05


def run(protocol: InsertionProtocol, session: Session) -> None:
    """Make every repetition, or those that remain.

    Raises
    ------
    TargetMissedError
        When no roll zero is known.
    CalibrationRefusedError
        When the grid pictures before and after show that the camera was bumped.
    """
    if problems := tuple(find_problems(protocol, session)):
        raise FileFormatError(problems)
    sight = session.open_sight(finds_tip=True)
    if problems := tuple(find_place_problems(protocol, sight.plane)):
        raise FileFormatError(problems)
    before = photograph_grid(protocol.sentinel, GridRole.BEFORE, session)
    roll_zero = _obtain_roll_zero(protocol, session, sight)
    for trial in session.trials(range(protocol.repetitions), starts_itself=True):
        session.tell_place(f"insertion {trial.what + 1} of {protocol.repetitions}")
        with trial:
            _insert_once(Insertion(protocol, session, sight, roll_zero, trial))
    after = photograph_grid(protocol.sentinel, GridRole.AFTER, session)
    require_same_grid(before, after, protocol.sentinel, sight, session)


def _obtain_roll_zero(protocol: InsertionProtocol, session: Session, sight: Sight) -> RollZero:
    """Return the certified roll zero of the needle; without one, find it as the protocol's section says."""
    needle = protocol.needle
    known = session.recall_roll_zero(needle.needle_id)
    if known is not None and session.is_referenced:
        confirm_needle_out(session)
        _move_to_start(protocol, session)
        return known
    if protocol.roll_zero is None:
        raise TargetMissedError(
            f"needle {needle.needle_id} has no certified roll zero as it is clamped now",
            "say how under roll_zero:; or, for a rig that keeps it, labrig run protocols/roll-zero.yaml finds it",
            reason="no_roll_zero",
        )
    found = find_roll_zero(protocol, protocol.roll_zero, session, sight)
    session.certify_roll_zero(found)
    return found


def _move_to_start(protocol: InsertionProtocol, session: Session) -> None:
    """Move needle and sheath back to zero if they are elsewhere; no needle is in tissue."""
    states = session.read_states()
    for axis, speed in (("insertion", protocol.insertion.speed_mm_s), ("linear", protocol.sheath.speed_mm_s)):
        if abs(states[axis].position) > _OFF_ZERO_MM:
            session.move(axis, 0.0, speed)


def _insert_once(insertion: "Insertion") -> None:
    """Place the block, plan, have the operator confirm the plan, insert, hold and withdraw.

    Raises
    ------
    TargetMissedError
        When there is no path, or the target was not reached; the needle is out.
    """
    session, protocol = insertion.session, insertion.protocol
    session.tell(f"insertion {insertion.repetition + 1} of {protocol.repetitions}")
    insertion.place()
    try:
        state, command = insertion.plan()
    except TargetMissedError as error:
        stop = InsertionStop(
            trial=insertion.trial, exit_status="failed", stop=error.reason, cause=error.message
        )
        session.record(stop)
        raise
    session.tell_next_point("at the next question")
    insertion.bevel.centre()
    session.move("linear", protocol.sheath.depth_mm, protocol.sheath.speed_mm_s)
    insertion.path.append(session.read_positions())
    picture = session.take_picture(InsertionRole.SCENE, insertion.trial)
    origin = insertion.find_sheath(picture)
    halt = insertion.follow_markers(picture, 0.0)
    if halt is not None:
        command = SteeringCommand(0.0, 0.0, 0.0, halt.reason, halt.detail)
    elif origin is not None or insertion.markers is not None:
        state, command = insertion.start_from(origin, state)
    if command.stop is None:
        insertion.confirm(picture, state, origin)
        state, command = steer(insertion, state, command)
    session.stop()
    ending = insertion.finish(state, command)
    if not ending.reached:
        raise TargetMissedError(ending.cause, ending.hint, reason=ending.reason)


def steer(
    insertion: "Insertion", state: SteeringState, command: SteeringCommand
) -> tuple[SteeringState, SteeringCommand]:
    """Run the closed loop until a stop: turn, advance, take a picture, find the tip, estimate and plan."""
    insertion.session.tell_next_point("after this turn or step, axes hold then")
    while command.stop is None:
        if insertion.session.reach_safe_point(IN_TISSUE, in_tissue=True):
            insertion.run_to_mm = 0.0  # the move ended where the needle was stopped
        insertion.turn_bevel(command.roll_rad, state)
        picture = insertion.advance(command)
        inserted_mm = max(picture.positions.insertion_mm, state.insertion_mm)
        expected = state.predict(inserted_mm, insertion.settings)
        seen = insertion.find_tip(picture, expected, state.tip)
        halt = insertion.follow_markers(picture, inserted_mm)
        sighting = TipSighting(inserted_mm, seen.position_mm)
        state, command = insertion.session.compute(
            partial(step_steering, state, sighting, insertion.settings, halt)
        )
        insertion.record_sighting(picture, seen, expected[:3, 3], state)
    insertion.session.tell_next_point("")
    return state, command


def _pick_places(protocol: InsertionProtocol, session: Session, trial: int) -> dict[str, Pixel | None]:
    """Take a picture and have the places named in it that the protocol asks for; return their pixels by their keys."""
    asked = {key: place for key, place in protocol.places.items() if place.ask}
    if not asked:
        return {}
    file = str(session.picture_path(session.take_picture(InsertionRole.TARGET, trial).frame))
    obstacles = [key for key in asked if key != "target"]
    return {
        key: session.ask(
            PickObstacle(file, obstacles.index(key), len(obstacles), place.radius_mm)
            if isinstance(place, InsertionObstacle)
            else PickTarget(file)
        ).pixel
        for key, place in asked.items()
    }


@lru_cache(maxsize=16)
def _plan_from_origin(
    protocol: InsertionProtocol, aim: Aim
) -> tuple[SteeringSettings, SteeringState, SteeringCommand]:
    """Return the settings and the first plan from the plane's origin; a campaign asks for the same one again."""
    settings = make_insertion_settings(protocol, aim.target_mm, aim.obstacles)
    return settings, *start_steering(settings)


@dataclass
class Insertion:
    """One insertion in progress: its parts, and the path of the needle so far."""

    protocol: InsertionProtocol
    session: Session
    sight: Sight
    roll_zero: RollZero
    made: TrialRun[int]
    markers: FollowedMarkers | None = None
    path: list[AxisPositions] = field(default_factory=list)
    run_to_mm: float = 0.0
    bounds: TargetErrorBounds | None = None

    def __post_init__(self) -> None:
        self.trial, self.repetition = self.made.number, self.made.what
        turning, radius_mm = self.protocol.policy.turning, self.protocol.planner.radius_mm
        self.bevel = Bevel(self.session, self.trial, self.roll_zero, turning, radius_mm)
        self.aim: Aim
        self.settings: SteeringSettings

    def place(self) -> None:
        """Have the block placed, ask for the places that the protocol asks for, and record target and obstacles."""
        protocol, plane, specimen = self.protocol, self.sight.plane, self.protocol.specimen
        obstacles = tuple(
            (plane.to_pixel(locate_place(key, place, plane)[1:]), place.radius_mm)
            for key, place in protocol.places.items()
            if isinstance(place, InsertionObstacle) and not place.ask
        )
        is_named = protocol.repetitions == 1 and self.trial == 0
        name = specimen.name if is_named else f"{specimen.name} {self.trial + 1}"
        self.session.ask(PlacePhantom(name, specimen.gelatin_percent, obstacles))
        self.aim = make_aim(protocol, plane, _pick_places(protocol, self.session, self.trial))
        self.record_start()

    def plan(self) -> tuple[SteeringState, SteeringCommand]:
        """Return the first plan.

        Raises
        ------
        TargetMissedError
            When the places cannot be aimed at, or there is no path.
        """
        if problems := tuple(find_aim_problems(self.protocol, self.aim, self.sight.plane)):
            raise TargetMissedError(problems[0].message, problems[0].hint, reason="no_target")
        plan = partial(_plan_from_origin, self.protocol, self.aim)
        self.settings, state, command = self.session.compute(plan)
        self._record_plan(state, None)
        self.find_markers()
        if command.stop is not None:
            told = f"the needle cannot be steered there: {command.detail}"
            raise TargetMissedError(told, state.refusal.hint if state.refusal else "", reason="no_path")
        self._warn(state)
        return state, command

    def _warn(self, state: SteeringState) -> None:
        """Warn of a tolerance below what the last picture will be able to certify."""
        problem = self.settings.problem
        there = EstimatedEnd(np.array(problem.target_mm[1:]), READ_PX * self.sight.plane.mm_per_px)
        bounds = self._bound_end(self.bevel.foresee(state.plan), None, there)
        if bounds is not None and (warning := bounds.warn(problem.tolerance_mm)) is not None:
            self.session.warn(warning)

    def turn_bevel(self, roll_rad: float, state: SteeringState) -> None:
        """Turn the bevel, if by anything."""
        if roll_rad != 0.0:
            self.bevel.turn(roll_rad, state, self.path[-1].insertion_mm)
            self.path.append(self.session.read_positions())

    def advance(self, command: SteeringCommand) -> TakenPicture:
        """Advance at the set speed, without stopping a moving needle, and take a picture at the commanded depth."""
        if abs(command.run_to_mm - self.run_to_mm) > SAME_MM:
            self.session.start("insertion", command.run_to_mm, self.protocol.insertion.speed_mm_s)
            self.run_to_mm = command.run_to_mm
        passes = command.run_to_mm - command.observe_at_mm > SAME_MM
        states = self.session.wait_until("insertion", command.observe_at_mm if passes else None)
        self.path.append(collect_axis_positions(states))
        return self.session.take_picture(NeedleRole.OBSERVE, self.trial)

    def find_tip(self, picture: TakenPicture, expected: FloatArray, tip: TipState) -> TipSearched:
        """Find the tip in a picture, near the pose (4, 4) that is expected after the last estimate."""
        return self.session.compute(partial(self.sight.find_tip, picture, expected, tip, self.bevel.base_rad))

    def find_markers(self) -> None:
        """Find every marker before the needle moves, if the protocol has any."""
        self.markers = FollowedMarkers.of(self.protocol, self.sight.plane)
        if self.markers is not None:
            self.follow_markers(self.session.take_picture(InsertionRole.MARKERS, self.trial), 0.0)

    def follow_markers(self, picture: TakenPicture, inserted_mm: float) -> Halt | None:
        """Move target and obstacles with their markers; return why the needle has to stop, if it has to."""
        if self.markers is None:
            return None
        dictionary, marker_ids = self.markers.markers.dictionary, self.markers.marker_ids
        found = self.session.compute(partial(self.sight.find_markers, picture, dictionary, marker_ids))
        self.markers = self.markers.take(found, self.trial, picture.frame, inserted_mm)
        self.session.record(self.markers.sought[-1])
        self.settings, halt = self.markers.place(self.settings, self.aim)
        return halt

    def find_sheath(self, picture: TakenPicture) -> TrialOrigin | None:
        """Find and record the sheath's pose before the needle leaves it; None if the protocol does not ask for it."""
        sheath = self.protocol.sheath
        if sheath.origin is None:
            return None
        origin = self.session.compute(partial(self.sight.find_sheath, picture, sheath, self.trial))
        self.session.record(InsertionSheath(origin=origin))
        return origin

    def start_from(
        self, origin: TrialOrigin | None, state: SteeringState
    ) -> tuple[SteeringState, SteeringCommand]:
        """Plan from the sheath's pose, if that was asked for; stop before the needle leaves one that was refused."""
        if origin is not None and not origin.accepted:
            return state, SteeringCommand(0.0, 0.0, 0.0, "sheath_astray", (origin.reason or "").rstrip("."))
        self.settings = start_at(self.settings, origin)
        # Markers may have moved the target since.
        known = None if self.markers or not state.plan.arcs else state.plan.psi
        state, command = self.session.compute(partial(start_steering, self.settings, known))
        self._record_plan(state, *((None, "markers") if origin is None else (origin.frame, "origin")))
        return state, command

    def confirm(self, picture: TakenPicture, state: SteeringState, origin: TrialOrigin | None = None) -> None:
        """Draw plan, axes, sheath, target and obstacles, and have it confirmed."""
        problem = self.settings.problem
        drawn = DrawnPlan(
            path_mm=sample_path(problem, state.plan)[:, 1:],
            target_mm=problem.target_mm[1:],
            tolerance_mm=problem.tolerance_mm,
            obstacles=tuple((obstacle.position_mm[1:], obstacle.radius_mm) for obstacle in problem.obstacles),
            sheath=None
            if origin is None or origin.tip_mm is None
            else (origin.tip_mm, origin.heading_rad or 0.0),
        )
        paint = partial(draw_plan, plane=self.sight.plane, plan=drawn)
        file = self.session.draw(picture, paint, InsertionRole.PLAN, self.trial)
        arcs = len(state.plan.arcs)
        plan = f"{arcs} {'arc' if arcs == 1 else 'arcs'}, {state.plan.length_mm or 0.0:.0f} mm"
        self.session.ask(ConfirmPlan(str(file), self.sight.plane.to_pixel(self.aim.target_mm[1:]), plan))

    def finish(self, state: SteeringState, command: SteeringCommand) -> Ending:
        """Hold, take the last picture, record the truth, withdraw along the path, and return how it ended."""
        session = self.session
        session.record(NeedleHeld(trial=self.trial, stop=command.stop, detail=command.detail))
        session.wait(_HOLD_S)
        final = session.take_picture(NeedleRole.FINAL, self.trial)
        self.follow_markers(final, state.insertion_mm)
        if command.stop == "target_reached" or session.is_judged:
            self.bounds = session.compute(partial(self._judge_end, final, state))
        bounds, doubt = self.bounds, None if self.markers is None else self.markers.doubt
        tolerance_mm = self.settings.problem.tolerance_mm
        ending = decide_ending(str(command.stop), command.detail, bounds, tolerance_mm, doubt)
        session.record_truth(self.trial)
        session.tell(ending.stop.replace("_", " "))
        if command.stop in UNSURE_STOPS:
            session.ask(ConfirmStopped(command.detail))
        speeds = find_speeds(session.description, self.protocol.insertion, self.protocol.sheath)
        withdraw(session, self.path, speeds)
        error_mm = None if bounds is None else bounds.in_plane_mm
        session.judge(self.trial, {"target_error_mm": error_mm})
        session.record(
            InsertionStop(
                trial=self.trial,
                exit_status="success" if ending.reached else "failed",
                outcome=ending.outcome,
                stop=ending.stop,
                cause=ending.cause,
                final_frame=final.frame,
                depth_mm=state.insertion_mm,
                replans=state.replans,
                centred=self.bevel.centred,
                error_mm=error_mm,
                interval_mm=None if bounds is None else bounds.interval_mm,
            )
        )
        return ending

    def _judge_end(self, final: TakenPicture, state: SteeringState) -> TargetErrorBounds | None:
        """Return the distance in space from the target, by the shaft in the last picture and the estimate."""
        protocol, roll_zero, bevel = self.protocol, self.roll_zero, self.bevel
        backlash_mm = protocol.policy.backlash_mm
        path = trace_path(bevel.turns, roll_zero.zero_rad, state.insertion_mm, bevel.centred, backlash_mm)
        try:
            shaft = self.sight.measure_end(final, protocol.needle.diameter_mm, protocol.sheath.diameter_mm)
        except MeasurementRefusedError:
            shaft = None
        estimate = EstimatedEnd(state.tip.position_mm[1:], state.tip.position_sd_mm, state.seen)
        return self._bound_end(path, shaft, estimate)

    def _bound_end(
        self, path: Sequence[RolledStretch], shaft: ShaftTip | None, estimate: EstimatedEnd
    ) -> TargetErrorBounds | None:
        """Return the distance in space from the target to the end of a path."""
        return judge_end(
            path,
            self.settings,
            make_out_of_plane(self.protocol, self.roll_zero.sd_rad, self.roll_zero.torsion),
            self.sight.plane,
            find_target_sd_mm(self.protocol, self.markers),
            shaft=shaft,
            estimate=estimate,
        )

    def record_start(self) -> None:
        """Record target and obstacles."""
        specimen, needle = self.protocol.specimen, self.protocol.needle
        self.session.record(
            InsertionStart(
                trial=self.trial,
                specimen=specimen.name,
                gelatin_percent=specimen.gelatin_percent,
                hole=0,
                hole_position_mm=specimen.first_hole_mm,
                needle_id=needle.needle_id,
                target_mm=self.aim.target_mm,
                tolerance_mm=self.protocol.target.tolerance_mm,
                obstacles=self.aim.obstacles,
                roll_zero_rad=self.roll_zero.zero_rad,
                roll_zero_sd_rad=self.roll_zero.sd_rad,
                torsion=self.roll_zero.torsion,
                marker_ids=list_marker_ids(self.protocol),
                repeats=self.made.repeats,
            )
        )

    def record_sighting(
        self, picture: TakenPicture, seen: TipSearched, predicted_mm: FloatArray, state: SteeringState
    ) -> None:
        """Record the observation and the estimate, and the plan if the planner ran."""
        fix = seen.fix
        self.session.record(
            TipObserved(
                trial=self.trial,
                frame=picture.frame,
                **describe_sighting(fix, seen.position_mm, predicted_mm, state),
                bevel_rad=self.bevel.base_rad,
                accepted=fix.accepted,
                tip_px=fix.tip_px,
                distinctness=fix.distinctness,
                near_px=seen.near_px,
                region_px=seen.region_px,
                misses=state.tip.misses,
            )
        )
        if state.why is not None:
            self._record_plan(state, picture.frame)
        self.session.tell(f"inserted {state.insertion_mm:.0f} mm")

    def _record_plan(self, state: SteeringState, frame: int | None, because: str | None = None) -> None:
        self.session.record(
            PathSought(
                trial=self.trial,
                frame=frame,
                depth_mm=state.insertion_mm,
                because=because or str(state.why),
                refusal=state.refusal and state.refusal.reason,
                cause=state.refusal and state.refusal.cause,
                replans=state.replans,
                from_mm=state.plan_from_mm,
                start_mm=state.plan_start[:3, 3].tolist(),
                start_rotation=state.plan_start[:3, :3].tolist(),
                plan=state.plan,
            )
        )
