"""A procedure on a virtual rig: the plan that `labrig check` tells, and the virtual runs of campaigns.

The plan is what the procedure did: its moves, pictures and questions, its rig time, and what it was refused. The world
is that of the rig file, or, for a bench, an ideal one with the stated noise of a camera; questions take the default
answer. A run of many trials is planned from the first of them: the others are taken to be like these.
"""

from collections.abc import Iterable, Iterator, Mapping

from labrig.analysis.experiment import TaskOutcome
from labrig.devices.needle_state import NEW, NeedleState
from labrig.devices.operator import PickPixel
from labrig.devices.rig_file import RigDescription
from labrig.errors import (
    BugError,
    FileFormatError,
    InputError,
    MeasurementRefusedError,
    Problem,
    TargetMissedError,
)
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.events import Event, Move, OperatorQuestion, TrialStart
from labrig.runner.conduct import Outcome, conduct
from labrig.runner.dialogue import Dialogue
from labrig.runner.experiment import Experiment, RunPlan
from labrig.runner.plan import find_calibration_problems, find_rig_problems
from labrig.runner.session import Session
from labrig.runner.sight import Sight, load_plane_map, load_tip_template
from labrig.runner.trials import Past
from labrig.runner.virtual_rig import EventList, VirtualRig
from labrig.runner.virtual_sight import WorldSight
from labrig.simulation.description import (
    GelDescription,
    NeedleDescription,
    PrintedMarkerDescription,
    SheathDescription,
    WorldDescription,
    stream,
)
from labrig.simulation.world import World
from labrig.vision.plane import PlaneMap
from labrig.vision.shaft_trace import tell_too_thin

ENOUGH_CALLS = 2000
"""After so many moves, pictures and questions no further trial is begun."""

_ANSWERED = {request.__name__ for request in PickPixel.__subclasses__()}
"""Questions that a bench alone can answer: what a dry run takes for the answer says nothing."""


class _EnoughError(Exception):
    """The trials made so far tell what the others take."""


class _Watch(EventList):
    """Ends a dry run before a trial when there are enough, and keeps what speaks against the run."""

    def __init__(self, unfit: Iterable[Problem]) -> None:
        super().__init__()
        self.unfit = list(unfit)

    def count(self, *kinds: type[Event]) -> int:
        """Return how many events are of these kinds."""
        return sum(isinstance(event, kinds) for event in self.events)

    def record_event(self, event: Event, t_s: float) -> None:
        """Keep an event."""
        if isinstance(event, TrialStart) and self.count(Move, OperatorQuestion) + self.frames > ENOUGH_CALLS:
            raise _EnoughError
        super().record_event(event, t_s)


def simulate(
    experiment: Experiment, protocol: ExperimentProtocol, rig: RigDescription | None, seed: int
) -> TaskOutcome:
    """Carry out a procedure in the world of a simulated rig, without pictures, and return what comes of it.

    The same seed gives the same bits in any process.

    Raises
    ------
    InputError
        When the experiment or the rig does not allow it, or the protocol cannot be run.
    """
    if rig is None or rig.world is None:
        raise InputError(
            "a virtual run is made in the world of a simulated rig, and there is none",
            "name a rig file of kind simulated",
        )
    record = EventList()
    outcome = conduct(experiment, protocol, _open_session(protocol, rig, record, seed)[0])
    if isinstance(outcome.error, InputError | BugError):
        raise outcome.error
    values = experiment.part("tell_values")(record.events, record.truths)
    return TaskOutcome(outcome.exit_status, outcome.reason or None, values)


def plan_run(
    experiment: Experiment, protocol: ExperimentProtocol, rig: RigDescription | None, past: Past | None = None
) -> RunPlan:
    """Return the plan of a run on a rig, or of what is left of one; the rig is None for a protocol that moves none."""
    if rig is None:
        estimate = experiment.find_part("estimate_s")
        return RunPlan(
            duration_s=0.0 if estimate is None else estimate(protocol),
            problems=tuple(experiment.part("find_problems")(protocol)),
        )
    record = _Watch(find_rig_problems(protocol, rig))
    try:
        session, virtual = _open_session(protocol, rig, record, protocol.seed)
    except InputError as error:
        return RunPlan(problems=tuple(record.unfit) or (Problem("rig", error.message, error.hint),))
    try:
        outcome = conduct(experiment, protocol, session, past)
    except _EnoughError:
        outcome = Outcome("success", "", None)
    return _describe(rig, session.dialogue, virtual, record, outcome)


def _open_session(
    protocol: ExperimentProtocol, rig: RigDescription, record: EventList, seed: int
) -> tuple[Session, VirtualRig]:
    needle = getattr(protocol, "needle", None)
    placed = rig if needle is None else rig.with_needle(needle)
    world = _IdealWorld(protocol) if placed.world is None else World(placed.world, seed)
    state = NEW if rig.state_path is None else NeedleState(rig.state_path).state
    exposure_s = 0.0 if rig.kind == "simulated" and rig.clock is None else 1.0 / rig.camera.rate_hz
    virtual = VirtualRig(placed, world, state, exposure_s)
    lens = None if placed.world is None else placed.world.lens

    def make_sight(rig: RigDescription, *, finds_tip: bool = False) -> Sight:
        plane = load_plane_map(rig)
        unseen = "" if needle is None else tell_too_thin(needle.diameter_mm / plane.mm_per_px)
        if unseen and isinstance(record, _Watch):
            record.unfit.append(Problem("needle.diameter_mm", unseen))
        if finds_tip and isinstance(record, _Watch):
            try:
                load_tip_template(rig, plane)
            except InputError as error:
                record.unfit.append(Problem("calibration.template", error.message, error.hint))
        record.sights += 1
        if isinstance(world, _IdealWorld):
            world.plane = plane
        return WorldSight(world, plane, stream(seed, "sightings"), lens)

    return Session(virtual, record, lambda _done, _doing: None, make_sight=make_sight), virtual


class _IdealWorld(World):
    """The world of a bench as its protocol expects it: nothing is off, and places are where the map has them."""

    def __init__(self, protocol: ExperimentProtocol) -> None:
        self.plane: PlaneMap | None = None
        self._printed = tuple(_lay_markers(protocol))
        needle, sheath = getattr(protocol, "needle", None), getattr(protocol, "sheath", None)
        radius_mm = protocol.expected_radius_mm
        gels = tuple(
            GelDescription(gelatin_percent=percent, radius_mean_mm=radius_mm, radius_sd_mm=0.0)
            for percent in (1e-3, 100.0)
        )
        super().__init__(
            WorldDescription(
                gels=gels,
                needle=NeedleDescription(**({} if needle is None else {"diameter_mm": needle.diameter_mm})),
                sheath=SheathDescription(lateral_play_sd_mm=0.0, angle_play_sd_deg=0.0),
                sheath_tip_at_origin_linear_mm=0.0 if sheath is None else sheath.origin_depth_mm,
            ),
            protocol.seed,
        )

    def point_at_pixel_mm(self, pixel: tuple[float, float]) -> tuple[float, float, float]:
        """Return where the map has a pixel."""
        if self.plane is None:
            return 0.0, 0.0, 0.0
        y, z = self.plane.to_mm([pixel])[0]
        return 0.0, float(y), float(z)

    def locate_markers(self) -> Mapping[int, tuple[PrintedMarkerDescription, tuple[float, float]]]:
        """Return the markers that the protocol follows; none of them moves."""
        return {marker.marker_id: (marker, (0.0, 0.0)) for marker in self._printed}

    def target_mark_px(self) -> tuple[float, float]:
        """Return a place straight ahead."""
        return self._find_px(0.0, 60.0)

    def obstacle_mark_px(self, asked: int) -> tuple[float, float]:
        """Return a place aside."""
        return self._find_px(30.0 + 10.0 * asked, 30.0)

    def _find_px(self, y: float, z: float) -> tuple[float, float]:
        return (0.0, 0.0) if self.plane is None else self.plane.to_pixel((y, z))


def _lay_markers(protocol: ExperimentProtocol) -> Iterator[PrintedMarkerDescription]:
    """Yield the markers that a protocol binds its places to, one beside the other."""
    section, places = getattr(protocol, "markers", None), getattr(protocol, "places", {})
    if section is None:
        return
    for number, marker_id in enumerate(dict.fromkeys(place.marker_id for place in places.values())):
        if marker_id is not None:
            yield PrintedMarkerDescription(
                marker_id=marker_id,
                dictionary=section.dictionary,
                side_mm=section.side_mm,
                position_mm=(-25.0 - 2.0 * section.side_mm * number, 40.0),
                x_mm=section.x_mm,
            )


def _describe(
    rig: RigDescription, dialogue: Dialogue, virtual: VirtualRig, record: _Watch, outcome: Outcome
) -> RunPlan:
    """Return the plan that a dry run tells."""
    questions = [event for event in record.events if isinstance(event, OperatorQuestion)]
    begun = record.count(TrialStart)
    trials = max(dialogue.planned - dialogue.past.kept, begun)
    share = trials / begun if begun else 1.0
    error = outcome.error
    uncalibrated = find_calibration_problems(rig) if record.sights else ()
    problems = list(dict.fromkeys((*record.unfit, *virtual.refused.values(), *uncalibrated)))
    if isinstance(error, FileFormatError):
        problems += error.problems
    elif isinstance(error, InputError | BugError) and not problems:
        problems.append(Problem("protocol", error.message, error.hint))
    elif isinstance(error, TargetMissedError) and error.reason == "no_roll_zero":
        problems.append(Problem("roll_zero", error.message, error.hint))
    elif isinstance(error, MeasurementRefusedError):
        dialogue.warnings.append(
            Problem("protocol", f"rehearsed, it ends early: {error.message}", error.hint)
        )
    assumed = any(question.request in _ANSWERED for question in questions) and rig.world is None
    # A dry run says for sure what nothing that is drawn decides.
    sure = isinstance(error, TargetMissedError) and error.reason in {"no_path", "no_marker"} and not assumed
    return RunPlan(
        trials=trials,
        duration_s=share * virtual.clock.now_s(),
        moves=round(share * record.count(Move)),
        pictures=round(share * (record.frames - record.drawn)),
        operator_steps=round(share * len(questions)),
        problems=tuple(problems),
        refusal=Problem("target", f"in a rehearsal {error.message}", error.hint) if error and sure else None,
        warnings=tuple(dialogue.warnings),
        uses_calibration=record.sights > 0,
    )
