"""What an insertion took for granted, and the world in which it is repeated virtually.

Target, obstacles and roll zero are those that the recorded insertion had. The protocol stays as it was: the virtual
needle is steered by what the run believed, through a world in which one value is another.
"""

import math
from collections.abc import Iterator, Mapping
from functools import partial

from labrig.analysis.outcome import TaskOutcome
from labrig.devices.needle_state import RollZero, Torsion
from labrig.devices.rig_file import RigDescription
from labrig.errors import InputError
from labrig.experiments.insertion.events import InsertionStart, PathSought
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.virtual import simulate
from labrig.experiments.insertion.virtual_bench import GEL_SDS, find_wandering_deg, make_assumed_rig
from labrig.record.reader import Run
from labrig.runner.assumption import Assumption, NotTried, Settings, VirtualRepeat
from labrig.simulation.description import GELS_DESIGN_RADIUS_MM, WorldDescription
from labrig.simulation.gel import interpolate_radius_mm

_WORLD = "rig.world"
_HINGES = f"{_WORLD}.needle"
_DISTURBANCES = f"{_WORLD}.disturbances"
_SHORTEST_MM = 0.1

_NOT_TRIED = (
    NotTried("target out of the plane", "the world moves its target along the plane alone"),
    NotTried("scale of the plane map", "the world and the rig's map of its plane are fixed to each other"),
    NotTried(
        "camera noise", "without pictures, its size is built in, as it was fitted to simulated pictures"
    ),
    NotTried("refraction in the gel", "the world has none"),
)


def list_assumptions(run: Run, protocol: InsertionProtocol, rig: RigDescription) -> VirtualRepeat:
    """Return how the first insertion of a run is repeated virtually, and what it took for granted.

    Parameters
    ----------
    rig : RigDescription
        As the record has it, in the folder of the record's calibration.

    Raises
    ------
    InputError
        When no insertion was begun, or none had a path; when targets were followed by markers, which takes pictures; or
        when a bench cannot be made into a simulated rig.
    RecordError
        When the record is damaged.
    """
    if protocol.markers is not None:
        raise InputError(
            f"{run.path}: its target was followed by markers in pictures, and a virtual run has none",
            "certify a run without markers",
        )
    start = _find_planned(run)
    roll_zero = _recall_roll_zero(run, start)
    notes = (
        [f"The first of {protocol.repetitions} insertions is repeated."] if protocol.repetitions > 1 else []
    )
    if rig.world is None:
        assumed = make_assumed_rig(protocol, rig, roll_zero)
        rig = assumed.rig
        notes.append(assumed.note)
    aimed = _aim_again(protocol, start)
    return VirtualRepeat(
        protocol=aimed,
        rig=rig.with_needle(aimed.needle),
        simulate=partial(simulate, roll_zero=roll_zero),
        arrives=partial(_arrives, tolerance_mm=aimed.target.tolerance_mm),
        arrival=(
            f"the needle ends within {aimed.target.tolerance_mm:g} mm of the target, in space, and cuts no obstacle"
        ),
        assumptions=tuple(_list(aimed, _require_world(rig.with_needle(aimed.needle)), roll_zero)),
        not_tried=_NOT_TRIED,
        notes=notes,
    )


def _find_planned(run: Run) -> InsertionStart:
    """Return the start of the first insertion that had a path."""
    planned = {path.trial for path in run.read_events(PathSought) if path.found}
    starts = [start for start in run.read_events(InsertionStart) if start.trial in planned]
    if not starts:
        raise InputError(
            f"{run.path} never planned: no insertion in it was begun with a path to its target",
            "labrig runs log says how it ended; certify a run that steered",
        )
    first = starts[0].trial
    return [start for start in starts if start.trial == first][-1]


def _recall_roll_zero(run: Run, start: InsertionStart) -> RollZero:
    """Return the roll zero and the torsion that an insertion used."""
    found = start.torsion
    torsion = (
        None
        if found is None
        else Torsion(found.lag_rad, found.lag_rad_per_mm, found.sd_rad, found.run, found.error)
    )
    return RollZero(start.needle_id, start.roll_zero_rad, start.roll_zero_sd_rad, run.path.name, torsion)


def _aim_again(protocol: InsertionProtocol, start: InsertionStart) -> InsertionProtocol:
    """Return the protocol with target and obstacles where the insertion had them, also if named in a picture."""
    places = (protocol.target, *protocol.obstacles)
    found_mm = (start.target_mm, *(obstacle.position_mm for obstacle in start.obstacles))
    target, *obstacles = (
        place.model_copy(update={"position_mm": found, "pixel": None, "ask": False})
        for place, found in zip(places, found_mm, strict=True)
    )
    update = {"target": target, "obstacles": tuple(obstacles), "repetitions": 1}
    return protocol.model_copy(update=update)


def _arrives(outcome: TaskOutcome, tolerance_mm: float) -> bool:
    error_mm, clearance_mm = (
        outcome.values.get(name) for name in ("true_target_error_mm", "true_min_clearance_mm")
    )
    at_target = isinstance(error_mm, float) and error_mm <= tolerance_mm
    return at_target and not (isinstance(clearance_mm, float) and clearance_mm < 0.0)


def _require_world(rig: RigDescription) -> WorldDescription:
    assert rig.world is not None
    return rig.world


def _list(protocol: InsertionProtocol, world: WorldDescription, roll_zero: RollZero) -> Iterator[Assumption]:
    yield _make_radius(protocol, world)
    yield from _list_bevel(protocol, roll_zero)
    yield from _list_hinges(protocol)
    yield from _list_disturbances(protocol)
    yield from _list_places(protocol)
    yield from _list_sheath(protocol, world)


def _make_radius(protocol: InsertionProtocol, world: WorldDescription) -> Assumption:
    """Return the radius: all gels of the world are scaled, so that their needle has it in the gel of the phantom."""
    mean_mm, _ = interpolate_radius_mm(world.gels, protocol.specimen.gelatin_percent)
    design = world.needle.design
    scale = (
        1.0
        if design is None
        else 0.5 * (design.radius_low_mm + design.radius_high_mm) / GELS_DESIGN_RADIUS_MM
    )
    tightest = max(GEL_SDS * gel.radius_sd_mm * mean_mm / gel.radius_mean_mm for gel in world.gels)
    stated_mm = protocol.planner.radius_mm

    def settings(radius_mm: float) -> Settings:
        share = radius_mm / (scale * mean_mm)
        gels = [{**gel.model_dump(), "radius_mean_mm": share * gel.radius_mean_mm} for gel in world.gels]
        return {f"{_WORLD}.gels": gels}

    return Assumption(
        name="radius of curvature",
        unit="mm",
        key="world.gels",
        stated=stated_mm,
        sd=protocol.estimator.radius_sd_mm,
        step=0.02 * stated_mm,
        lowest=min(stated_mm, max(0.3 * stated_mm, scale * tightest)),
        highest=3.0 * stated_mm,
        settings=settings,
    )


def _list_bevel(protocol: InsertionProtocol, roll_zero: RollZero) -> Iterator[Assumption]:
    zero_deg, torsion = math.degrees(roll_zero.zero_rad), roll_zero.torsion
    clamp = f"{_HINGES}.clamp_roll_deg"

    def clamped(off_deg: float) -> Settings:
        return {clamp: math.remainder(-zero_deg - off_deg, 360.0)}

    yield Assumption(
        "roll zero", "deg", clamp.removeprefix("rig."), 0.0, math.degrees(roll_zero.sd_rad), 2.0, -90.0, 90.0,
        clamped,
    )  # fmt: skip
    lag_deg = 0.0 if torsion is None else math.degrees(torsion.lag_rad)
    unseen = protocol.out_of_plane
    stated_sd_deg = None if unseen is None else unseen.lag_sd_deg
    yield _turn(
        f"{_HINGES}.torsion_lag_deg",
        ("lag of the bevel by torsion", "deg"),
        lag_deg,
        stated_sd_deg if torsion is None else math.degrees(torsion.sd_rad),
        step=2.0,
        to=(0.0, 90.0),
    )


def _list_hinges(protocol: InsertionProtocol) -> Iterator[Assumption]:
    policy = protocol.policy
    plays = (
        ("backlash_mm", "play of the hinges", policy.backlash_mm),
        ("hinge_closing_mm", "length over which the hinges close", policy.closing_mm),
    )
    for key, name, stated_mm in plays:
        limits = (min(stated_mm, _SHORTEST_MM), 40.0)
        yield _turn(
            f"{_HINGES}.{key}", (name, "mm"), stated_mm, None, step=max(0.5, 0.5 * stated_mm), to=limits
        )


def _list_disturbances(protocol: InsertionProtocol) -> Iterator[Assumption]:
    """Yield what disturbs the path. A spread that the protocol states is its own standard deviation."""
    estimator = protocol.estimator
    in_plane = estimator.process_sd_deg_per_root_mm
    slip = 0.0 if estimator.method == "paper" else estimator.slip_sd
    wander = "deg/√mm"
    key = "disturbances.heading_deg_per_root_mm"
    yield _spread(key, ("wandering in the plane", wander), in_plane, step=0.2, highest=10.0)
    key = "disturbances.out_of_plane_deg_per_root_mm"
    across = find_wandering_deg(protocol)
    yield _spread(key, ("wandering out of the plane", wander), across, step=0.1, highest=10.0)
    key = "disturbances.slip_sd_fraction"
    yield _spread(key, ("slip of the needle", "of its length"), slip, step=0.01, highest=0.1)
    yield _turn(
        f"{_DISTURBANCES}.cavities",
        ("cavities in the path", ""),
        0.0,
        None,
        step=1.0,
        to=(0.0, 20.0),
        whole=True,
    )


def _list_places(protocol: InsertionProtocol) -> Iterator[Assumption]:
    """Yield the places of target and obstacles: nobody tells the run that they are elsewhere."""
    sd_mm = protocol.target.sd_mm

    def shift(axis: int, by_mm: float) -> Settings:
        return {
            f"{_WORLD}.target_slides": {"at_mm": 0.0, "by_mm": [by_mm if axis == 0 else 0.0, by_mm * axis]}
        }

    for axis, name in enumerate(("target aside (y)", "target along the insertion (z)")):
        yield Assumption(
            name, "mm", "world.target_slides", 0.0, sd_mm, 0.5, -50.0, 50.0, partial(shift, axis)
        )
    if protocol.obstacles:
        yield _turn(
            f"{_WORLD}.obstacle_shift_sd_mm", ("obstacles beside their places (SD)", "mm"), 0.0, None, step=0.5,
            to=(0.0, 30.0),
        )  # fmt: skip


def _list_sheath(protocol: InsertionProtocol, world: WorldDescription) -> Iterator[Assumption]:
    unseen = protocol.out_of_plane
    start_mm, start_deg = (0.0, 0.0) if unseen is None else (unseen.start_sd_mm, unseen.start_sd_deg)
    stands_at_mm = world.sheath_tip_at_origin_linear_mm

    def move_along(by_mm: float) -> Settings:
        return {f"{_WORLD}.sheath_tip_at_origin_linear_mm": stands_at_mm - by_mm}

    yield Assumption(
        "sheath's end along the insertion", "mm", "world.sheath_tip_at_origin_linear_mm", 0.0, None, 0.25, -20.0, 20.0,
        move_along,
    )  # fmt: skip
    turned_deg = protocol.estimator.start_sd_deg
    plays = (
        ("lateral_play_sd_mm", ("sheath aside in the plane (SD)", "mm"), 0.0, 20.0),
        ("angle_play_sd_deg", ("sheath turned in the plane (SD)", "deg"), turned_deg, 10.0),
        ("x_play_sd_mm", ("sheath out of the plane (SD)", "mm"), start_mm, 20.0),
        ("lean_play_sd_deg", ("sheath leaning out of the plane (SD)", "deg"), start_deg, 10.0),
    )
    for key, shown, stated, highest in plays:
        yield _spread(f"sheath.{key}", shown, stated, step=0.25, highest=highest)


def _spread(key: str, shown: tuple[str, str], stated: float, *, step: float, highest: float) -> Assumption:
    """Return a spread: it only grows, and is measured in multiples of what is stated."""
    return _turn(f"{_WORLD}.{key}", shown, stated, stated, step=step, to=(stated, max(stated, highest)))


def _turn(
    key: str,
    shown: tuple[str, str],
    stated: float,
    sd: float | None,
    *,
    step: float,
    to: tuple[float, float],
    whole: bool = False,
) -> Assumption:
    """Return an assumption whose value is that of a key of the world; `shown` are its name and unit."""

    def settings(value: float) -> Mapping[str, object]:
        return {key: round(value) if whole else value}

    return Assumption(*shown, key.removeprefix("rig."), stated, sd, step, *to, settings, whole)
