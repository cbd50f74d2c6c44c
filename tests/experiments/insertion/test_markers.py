"""Targets that are bound to a marker: reached where they were pushed, replayed, measured again, stopped in doubt."""

import math
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest

from labrig.analysis.run import analyze_run
from labrig.devices.drives.states import describe_statusword
from labrig.devices.operator import ConfirmStopped
from labrig.errors import FileFormatError
from labrig.experiments.declared import PROTOCOL_MODELS, find_experiment
from labrig.experiments.insertion.aim import Aim
from labrig.experiments.insertion.markers import FollowedMarkers
from labrig.experiments.insertion.protocol import InsertionProtocol, Markers
from labrig.experiments.insertion.result import InsertionResult
from labrig.experiments.insertion.scene import make_films
from labrig.experiments.insertion.settings import make_insertion_settings
from labrig.experiments.registry import follow_run
from labrig.protocol.load import load_protocol
from labrig.record.reader import Run, open_run
from labrig.report.rerun_view import write_view
from labrig.steering.problem import Obstacle, Surroundings
from labrig.vision.marker import MarkerFix
from labrig.vision.plane import PlaneMap
from tests.analysis.synthetic import NOW, PROVENANCE
from tests.devices.rigs import large_rig
from tests.experiments.insertion.recorded import FOLDER
from tests.experiments.insertion.test_procedure import (
    EVEN,
    FROM_THE_BEGINNING,
    conduct_insertion,
    events,
    insertion,
    open_certified_rig,
    truth,
)
from tests.pages import write_page
from tests.rerun_files import read_view
from tests.runner.sessions import PROTOCOLS, Watched, find_problems, large_bench
from tests.runner.test_pausing import require_identical

BOUND = ("target.marker_id=7", "markers={side_mm: 6}")
NEAR = ("target.position_mm=[0,-3,25]", "insertion.frame_every_mm=2")
MARKER = "marker_id: 7, side_mm: 6, position_mm: [-28, 45]"
CORNERS_MM = 3.0 * np.array([(1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)])
WAY_MM = math.hypot(3, 25)
MOVES = "world.target_moves_mm=3"
"""The target has moved by 3 mm, aside and ahead, when the needle gets there."""


def world(marker: str = MARKER) -> str:
    """Return the override that lays a marker into the world."""
    return f"world.markers=[{{{marker}}}]"


@cache
def record_followed() -> Run:
    """Conduct an insertion to a target that is pushed by 3 mm, followed by its marker."""
    protocol = load_protocol(PROTOCOLS / "insertion.yaml", PROTOCOL_MODELS, [*FROM_THE_BEGINNING, *BOUND])
    with large_bench(Path(mkdtemp(dir=FOLDER.name)), protocol, (*EVEN, world(), MOVES)) as opened:
        outcome, run = opened.conduct(protocol)
    assert outcome.exit_status == "success"
    return run


def test_a_pushed_target_is_reached_by_its_marker_alone(tmp_path: Path) -> None:
    """Bound to its marker it is reached where it is; unbound the needle goes to where it was, 3 mm beside it."""
    assert truth(record_followed())["true_target_error_mm"] < 1.0
    _, unbound = conduct_insertion(tmp_path, insertion(*NEAR), (*EVEN, world(), MOVES))
    assert truth(unbound)["true_target_error_mm"] > 2.5
    assert not events(unbound, "markers")


def test_the_record_has_every_displacement_and_replays() -> None:
    """Each picture that steered has the marker's displacement, which is the world's; a replay is identical."""
    run = record_followed()
    seen = events(run, "markers")
    assert events(run, "trial_start")[0]["marker_ids"] == [7]
    assert {look["frame"] for look in events(run, "observation")} < {event["frame"] for event in seen}
    for event in seen:
        (marker,) = event["markers"]
        assert (marker["believed"], math.hypot(*marker["displacement_mm"])) == (
            True,
            pytest.approx(event["depth_mm"] * 3 / WAY_MM, abs=0.05),
        )
    require_identical(run)


def test_the_analysis_measures_markers_again_and_shows_where_the_target_went() -> None:
    """The estimates are the live ones; errors, film and page are of the moved target; the settings may be changed."""
    run = record_followed()
    result = analyze_run(run, find_experiment("insertion"), workers=1, created=NOW, provenance=PROVENANCE)
    assert isinstance(result.content, InsertionResult)
    (trial,) = result.content.insertions
    ((moves, marker),) = trial.markers
    assert (trial.as_recorded, marker.marker_id, moves) == (True, 7, "target")
    assert math.hypot(*marker.displacement_mm) == pytest.approx(3.0, abs=0.4)
    live = [(True, tuple(event["markers"][0]["displacement_mm"])) for event in events(run, "markers")]
    assert [(step.believed, step.displacement_mm) for step in trial.marker_steps] == live
    assert trial.target_error_mm == pytest.approx(trial.true_target_error_mm, abs=0.4)
    assert trial.target_error_sources_mm is not None
    assert trial.target_error_sources_mm.target == pytest.approx(0.1)
    page = write_page(open_run(run.path), result, NOW).read_text(encoding="utf-8")
    assert "<h3>What the markers moved</h3>" in page
    assert "Markers: displacement since the start" in page
    (film,) = make_films(run, result.content)
    first, last = (
        next(stroke.px for stroke in picture.strokes if stroke.name == "target").mean(axis=0)
        for picture in (film.pictures[0], film.pictures[-1])
    )
    assert math.dist(first, last) > 20.0
    followed = read_view(write_view(run, {}, follow_run(run), describe_statusword))
    assert followed["/depth/to the target"][-1] < 1.0


def test_a_marker_that_is_lost_stops_the_axes(tmp_path: Path) -> None:
    """The needle stops, a person is told why, and it is withdrawn; the run ends as no."""
    protocol = insertion(*NEAR, *BOUND, "markers.most_lost_mm=4")
    with open_certified_rig(tmp_path, protocol, (*EVEN, world(f"{MARKER}, covered_mm: [4, 100]"))) as opened:
        watched = opened.opened.rig.operator = Watched(opened.opened.rig.operator)
        outcome, run = opened.conduct(protocol)
    assert outcome.error is not None
    assert (outcome.reason, outcome.error.exit_code) == ("marker_lost", 1)
    (asked,) = (request for request in watched.asked if isinstance(request, ConfirmStopped))
    assert "marker 7" in asked.reason
    assert 4.0 < run.states["insertion_mm"].max() < 11.0
    assert abs(run.states.iloc[-1]["insertion_mm"]) < 0.05


@pytest.mark.parametrize(
    ("what", "told"),
    [
        (world("marker_id: 8, side_mm: 6, position_mm: [-28, 45]"), "marker 7 of DICT_4X4_50 is missing: it was not"),
        (world(f"{MARKER}}}, {{marker_id: 7, side_mm: 6, position_mm: [20, 60]"), "is missing: it was seen 2 times"),
        (world(f"{MARKER}, x_mm: -20"), "and markers.side_mm is 6"),
    ],
)  # fmt: skip
def test_without_its_markers_the_needle_does_not_move(tmp_path: Path, what: str, told: str) -> None:
    """A marker that is missing, there twice, or beside the plane ends the run before anything moves, and is named."""
    outcome, run = conduct_insertion(tmp_path, insertion(*NEAR, *BOUND), (*EVEN, what))
    assert outcome.error is not None
    assert (outcome.reason, outcome.error.exit_code) == ("no_marker", 1)
    assert told in outcome.error.message
    assert not events(run, "move")


START = (-20.0, 30.0)
PLANE = PlaneMap.from_scale(10.0, (0.0, 0.0), "right")
AIM = Aim((0.0, -3.0, 25.0), (Obstacle((0.0, 9.0, 25.0), 4.0), Obstacle((0.0, 12.0, 40.0), 4.0)))


def follow(
    *seen: tuple[float, tuple[float, float] | None], bound: tuple[int | None, ...] = (7, None, None)
) -> FollowedMarkers:
    """Follow marker 7 from (-20, 30) over pictures, each an insertion length and where it was seen."""
    trust = Markers(side_mm=6.0, sd_mm=0.1, lost_sd_mm_per_mm=0.05, most_lost_mm=10.0, jump_mm=1.0)
    followed = FollowedMarkers(trust, bound, PLANE)
    for frame, (inserted_mm, seen_mm) in enumerate(((0.0, (-20.0, 30.0)), *seen)):
        corners_px = None if seen_mm is None else PLANE.to_px(np.array(seen_mm) + CORNERS_MM)
        followed = followed.take([MarkerFix(7, corners_px)], 0, frame, inserted_mm)
    return followed


@pytest.mark.parametrize(
    ("seen", "moved_mm", "unseen_mm", "told"),
    [
        (((1, (-19.8, 30.0)), (3, None), (5, None)), (0.2, 0.0), 4.0, None),
        (((1, (-19.8, 30.0)), (3, None), (5, None), (6, (-19.5, 30.0))), (0.5, 0.0), 0.0, None),
        (((8, START), (14, None), (9, None)), (0.0, 0.0), 11.0, "not seen while the needle moved by 11.0 mm"),
        (((8, START), (14, None), (10, None)), (0.0, 0.0), 10.0, None),
        (((1, START), (2, (-18.0, 30.0))), (0.0, 0.0), 1.0, None),
        (((1, START), (2, (-18.0, 30.0)), (3, (-20.0, 30.1)), (4, (-18.0, 30.0))), (0.0, 0.1), 1.0, None),
        (((2, (-18.0, 30.0)), (3, (-20.0, 35.0))), (0.0, 0.0), 3.0, None),
        # unseen over 10 mm it may have moved by 1 mm and three times 0.5 mm
        (((1, START), (6, None), (11, (-17.6, 30.0))), (2.4, 0.0), 0.0, None),
        (((1, START), (6, None), (11, (-17.4, 30.0))), (0.0, 0.0), 10.0, None),
        (((2, (-18.0, 30.0)), (3, (-17.9, 30.0))), (0.0, 0.0), 3.0, "marker 7 has jumped by 2.1 mm and stays there"),
    ],
)  # fmt: skip
def test_a_marker_is_held_believed_or_stops_the_needle(
    seen: tuple[tuple[float, tuple[float, float] | None], ...],
    moved_mm: tuple[float, float],
    unseen_mm: float,
    told: str | None,
) -> None:
    """Unseen it is held and less certain; a jump counts once it stays; too long unseen, on any way, it is lost."""
    followed = follow(*seen)
    (marker,) = followed.last
    assert marker.displacement_mm == pytest.approx(moved_mm, abs=1e-9)
    assert marker.unseen_mm == pytest.approx(unseen_mm)
    assert marker.sd_mm == pytest.approx(math.hypot(0.1, 0.05 * unseen_mm))
    assert (followed.halt is None) == (told is None)
    assert told is None or told in followed.halt.detail


def test_a_marker_that_strays_in_the_last_picture_is_no_arrival() -> None:
    """No picture follows that could tell whether it stays; one that was only covered there is in no doubt."""
    doubt = follow((1.0, (-17.0, 30.0))).doubt
    assert doubt is not None
    assert (doubt.stop, "marker 7" in doubt.cause) == ("marker_jumped", True)
    assert follow((1.0, None)).doubt is None


def test_target_and_obstacles_are_planned_with_where_their_markers_are() -> None:
    """An uncertain obstacle is kept off further; what overlaps now halts the needle, and stays where it was before."""
    protocol = insertion(*NEAR, *BOUND)
    assert isinstance(protocol, InsertionProtocol)
    settings = make_insertion_settings(protocol, AIM.target_mm, AIM.obstacles)
    beside, halt = follow((1.0, (-19.2, 29.5)), bound=(7, None, 7)).place(settings, AIM)
    assert halt is None
    assert beside.problem.target_mm == pytest.approx((0.0, -2.2, 24.5))
    assert [ball.position_mm[1] for ball in beside.problem.obstacles] == pytest.approx([9.0, 12.8])
    grown = Surroundings(beside.problem).keep_off_mm - Surroundings(settings.problem).keep_off_mm
    assert grown == pytest.approx([0.0, 2.0 * 0.1])
    inside, halt = follow(*((float(mm), (-20.0 + 0.9 * mm, 30.0)) for mm in range(12))).place(beside, AIM)
    assert halt is not None
    assert (halt.reason, "target lies inside obstacle 1" in halt.detail) == ("blocked", True)
    assert inside.problem.target_mm == beside.problem.target_mm


@pytest.mark.parametrize(
    ("overrides", "where", "told"),
    [
        (("target.marker_id=50", "markers={side_mm: 6}"), "target.marker_id", "50 is not in DICT_4X4_50, whose"),
        (("target.marker_id=7", "markers={side_mm: 2}"), "markers.side_mm", "print them 3 mm large"),
        (("target.marker_id=7", "markers={side_mm: 6, x_mm: -190}"), "markers.x_mm", "state how far they are"),
        (("target.marker_id=7",), "--set target.marker_id", "does not describe markers"),
        (("markers={side_mm: 6}",), "--set markers", "no target and no obstacle is bound to a marker"),
    ],
)  # fmt: skip
def test_markers_that_cannot_be_told_are_named_before_a_run(
    overrides: tuple[str, ...], where: str, told: str
) -> None:
    """What the dictionary lacks, the camera cannot tell, or nothing names, or describes."""
    beginning = [*FROM_THE_BEGINNING, *overrides]
    try:
        protocol = load_protocol(PROTOCOLS / "insertion.yaml", PROTOCOL_MODELS, beginning)
        problems = find_problems(protocol, large_rig())
    except FileFormatError as refused:
        problems = refused.problems
    assert [problem.where for problem in problems] == [where]
    assert told in f"{problems[0].message} {problems[0].hint}"
