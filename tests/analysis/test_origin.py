"""What the sheath in each trial, and the paper before and after a run, say of its pictures."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from labrig.analysis.origin import find_origins
from labrig.analysis.sentinel import compare_grid_pictures
from labrig.experiments.shared.curvature_result import PictureResult
from labrig.experiments.shared.picture_results import complete_picture
from labrig.protocol.sections import Sheath, SheathOrigin
from labrig.record.events import FrameLine
from labrig.vision.error_budget import ErrorBudget
from labrig.vision.plane import PlaneMap
from tests.analysis.synthetic import ORIGIN_PX, PX_PER_MM, SIZE, needle_picture
from tests.vision.renderer import Photo, Picture, Sheet, flat_camera

PLANE = PlaneMap.from_scale(PX_PER_MM, ORIGIN_PX, "right", SIZE)


def draw_sheath(along_px: int = 0, aside_px: int = 0, turned_deg: float = 0.0) -> NDArray[np.uint8]:
    """Draw the sheath alone, moved along the insertion and towards +y, seen by a camera that is turned."""
    image = np.roll(needle_picture(None), (-aside_px, along_px), axis=(0, 1))
    about = cv2.getRotationMatrix2D(ORIGIN_PX, turned_deg, 1.0)
    seen = cv2.warpAffine(image, about, SIZE, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen if turned_deg else image, dtype=np.uint8)


def origins(pictures, limits=None, linear_mm=(15.0,) * 5):
    """Return the origin found for each of these trials."""
    lines = [FrameLine(frame=2 * n, file="", trial=n, linear_mm=linear_mm[n]) for n in range(len(pictures))]
    sheath = Sheath(depth_mm=15.0, speed_mm_s=5.0, diameter_mm=2.0, origin=limits)
    return find_origins(lambda frame: pictures[frame // 2], lines, PLANE, sheath)


def test_sheath_is_found_where_it_stands():
    """Tip, pixel and direction of each trial, with the travel that the encoder read, none refused."""
    for trial, origin in enumerate(origins([draw_sheath()] * 3, SheathOrigin())):
        assert origin.tip_mm == pytest.approx((0.0, 0.0), abs=0.05)
        assert origin.tip_px == pytest.approx(ORIGIN_PX, abs=0.1 * PX_PER_MM)
        assert origin.heading_rad == pytest.approx(0.0, abs=0.01)
        told = (origin.trial, origin.linear_mm, origin.expected_mm, origin.accepted)
        assert told == (trial, 15.0, (0.0, 0.0), True)
        assert max(origin.disagreement_mm, origin.from_others_mm) < 0.1


@pytest.mark.parametrize(
    ("moved", "words"),
    [
        ({"along_px": 10}, ("1.0", "beyond", "linear encoder", "slipped")),
        ({"along_px": -10}, ("short of", "slipped")),
        ({"aside_px": 7}, ()),
        ({"aside_px": -7}, ()),
        ({"aside_px": 30}, ("3.0", "play", "bumped")),
        ({"aside_px": -30}, ("3.0", "play", "bumped")),
        ({"turned_deg": 0.5}, ()),
        ({"turned_deg": 4.0}, ("4.0 degrees", "camera was turned")),
    ],
)
def test_the_first_trial_alone_can_be_refused(moved, words):
    """A slip, a bump and a turn are told apart; across, 0.7 mm is play; without limits nothing is refused."""
    image = draw_sheath(**moved)
    (only,) = origins([image], SheathOrigin())
    assert only.along_mm == pytest.approx(0.1 * moved.get("along_px", 0), abs=0.1)
    assert only.across_mm == pytest.approx(0.1 * moved.get("aside_px", 0), abs=0.05)
    assert only.heading_rad == pytest.approx(np.radians(moved.get("turned_deg", 0.0)), abs=0.01)
    assert only.accepted is not bool(words)
    assert all(word in (only.reason or "") for word in words)
    assert ("slipped" in (only.reason or "")) == ("along_px" in moved)
    assert origins([image])[0].accepted


def test_the_depth_that_belongs_to_the_origin_may_be_another_than_the_sheaths():
    """With the origin named for a depth of 16 mm the tip is expected a millimetre before it at 15 mm."""
    (only,) = origins([draw_sheath(-10)], SheathOrigin(depth_mm=16.0))
    assert only.accepted
    assert only.expected_mm == pytest.approx((0.0, -1.0))


def test_sheath_that_stands_elsewhere_than_its_encoder_says_is_refused():
    """The trial is named with the distance, and its radii are refused with the reason; the others are kept."""
    found = origins([draw_sheath(round(along * PX_PER_MM)) for along in (0.0, 2.0, 0.0, 0.0)])
    assert [origin.accepted for origin in found] == [True, False, True, True]
    assert found[1].disagreement_mm == pytest.approx(2.0, abs=0.1)
    assert "linear encoder and the other trials" in (found[1].reason or "")
    pictures = [complete_picture(picture(origin.trial), origin, None) for origin in found]
    assert [measurement.accepted for measurement in pictures] == [True, False, True, True]
    assert pictures[1].reason == found[1].reason


@pytest.mark.parametrize(
    ("along_px", "linear_mm", "refused"),
    [((4, 4, 4, -3, 4), (15.0,) * 5, 3), ((0, 20, 0, 0), (15.0, 17.0, 15.0, 15.0), None)],
    ids=["all but one stand beyond a zero set by eye", "it went as far as its encoder says"],
)
def test_a_slip_is_found_by_the_other_trials_and_another_travel_is_none(along_px, linear_mm, refused):
    """Of sheaths 0.4 mm beyond the origin one 0.3 mm short of it has slipped; another travel is expected."""
    found = origins([draw_sheath(along) for along in along_px], SheathOrigin(), linear_mm)
    assert [origin.accepted for origin in found] == [number != refused for number in range(len(found))]
    assert refused is None or "the other trials" in (found[refused].reason or "")


def test_sheath_that_is_not_seen_is_said_so():
    """A trial without a visible sheath has a reason in place of an origin, and its radius is not refused."""
    found = origins([np.full(SIZE[::-1], 160, np.uint8)])
    assert not found[0].accepted
    assert "not found in frame 0" in (found[0].reason or "")
    assert complete_picture(picture(0), found[0], None).accepted


def test_tip_is_told_from_the_origin_of_its_trial():
    """The tip is relative to the pose of its trial's sheath; an imported picture uses its own sheath."""
    (found,) = origins([draw_sheath(20, turned_deg=3.0)])
    heading = found.heading_rad
    along = np.array([np.sin(heading), np.cos(heading)])
    tip = np.array(found.tip_mm) + 30.0 * along - 4.0 * np.array([np.cos(heading), -np.sin(heading)])
    measured = picture(0).model_copy(update={"tip_mm": tuple(tip.tolist())})
    shifted = complete_picture(measured, found, None)
    assert shifted.tip_from_origin_mm == pytest.approx((-4.0, 30.0))
    assert (shifted.origin_mm, shifted.origin_heading_rad) == (found.tip_mm, heading)
    own = {"trial": None, "sheath_tip_mm": (1.0, 2.0), "sheath_heading_rad": 0.0, "tip_mm": (0.0, 32.0)}
    imported = measured.model_copy(update=own)
    assert complete_picture(imported, None, None).tip_from_origin_mm == pytest.approx((-1.0, 30.0))


def picture(trial: int) -> PictureResult:
    """Return an accepted picture of a trial."""
    return PictureResult(
        frame=2 * trial + 1, image="x.png", role="final", trial=trial, specimen="gel", gelatin_percent=10.0, hole=0,
        needle_id="N1", insertion_mm=40.0, found=True, accepted=True, reason=None,
    )  # fmt: skip


PAPER_PX_PER_MM = 16.0
PAPER_PLANE = PlaneMap.from_scale(PAPER_PX_PER_MM, (0.0, 0.0), "right", (800, 600))
LINES = [
    FrameLine(frame=0, file="", role="grid-before"),
    FrameLine(frame=1, file="", role="final"),
    FrameLine(frame=2, file="", role="grid-after"),
]


def grid(pitch_px: float) -> Picture:
    """Draw ruled paper."""
    photo = Photo(noise=2.0)
    return Sheet("1", flat_camera(pitch_px, (800, 600)), photo, ink="grey", width_mm=0.15, samples=2).draw()


BARE = np.full((600, 800), 120, np.uint8)


def radius(**known: object) -> PictureResult:
    """Return an accepted picture with a radius."""
    values = {"radius_mm": 28.0, "sigma_radius_mm": 0.05, "radius_ci95_mm": (27.9, 28.1), **known}
    return picture(0).model_copy(update=values)


def test_drift_becomes_an_error_bar():
    """A drift of 0.2 % widens sigma and interval, and leaves the radius unchanged."""
    pictures = grid(PAPER_PX_PER_MM), None, grid(PAPER_PX_PER_MM * 1.002)
    sentinel = compare_grid_pictures(pictures.__getitem__, LINES, PAPER_PLANE, 1.0)
    assert sentinel.drift == pytest.approx(0.002, abs=2e-4)
    wider = complete_picture(radius(), None, sentinel)
    assert wider.accepted
    assert wider.radius_mm == 28.0
    assert wider.sigma_radius_mm == pytest.approx(np.hypot(0.05, 0.056), rel=0.1)
    assert wider.radius_budget_mm is None
    listed = complete_picture(radius(radius_budget_mm=ErrorBudget(fit=0.05)), None, sentinel)
    assert listed.radius_budget_mm.total == pytest.approx(listed.sigma_radius_mm)
    assert wider.radius_ci95_mm == pytest.approx((28.0 - 0.149, 28.0 + 0.149), abs=0.015)


HALVED = PlaneMap.from_scale(PAPER_PX_PER_MM / 2.0, (0.0, 0.0), "right", (800, 600))


@pytest.mark.parametrize(
    ("plane", "before", "after", "words"),
    [
        (PAPER_PLANE, grid(PAPER_PX_PER_MM), grid(PAPER_PX_PER_MM * 1.02), "the camera was bumped"),
        (HALVED, grid(PAPER_PX_PER_MM), grid(PAPER_PX_PER_MM), "lines are 16.0 px apart in the picture"),
        (PAPER_PLANE, BARE, BARE, "cannot be compared"),
    ],
    ids=["bumped", "wrong map", "no paper"],
)
def test_what_the_paper_contradicts_refuses_every_radius(plane, before, after, words):
    """Another scale after the run, another one than the map's, or no grid: the reason is at each picture."""
    sentinel = compare_grid_pictures(lambda frame: after if frame else before, LINES, plane, 1.0)
    assert not sentinel.accepted
    assert sentinel.view == plane.view_sentence()
    assert HALVED.view_sentence() == "The picture is 100 mm wide and 75 mm high at the paper."
    refused = complete_picture(radius(), None, sentinel)
    assert not refused.accepted
    assert words in (refused.reason or "")


def test_run_without_both_pictures_is_told_so():
    """An aborted run without the second picture is not refused; the result states that the drift is unknown."""
    sentinel = compare_grid_pictures(lambda _: grid(PAPER_PX_PER_MM), LINES[:1], PAPER_PLANE, 1.0)
    assert sentinel.drift is None
    assert "both before and after" in (sentinel.reason or "")
    assert complete_picture(radius(), None, sentinel) == complete_picture(radius(), None, None) == radius()
