"""The sheath's pose in each trial, and trials in which it deviates."""

from collections.abc import Sequence
from functools import partial

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from labrig.analysis.origin import find_origins, to_origin_frame
from labrig.analysis.result import TrialOrigin
from labrig.experiments.shared.curvature_result import PictureResult
from labrig.experiments.shared.picture_results import complete_picture
from labrig.protocol.sections import Sheath, SheathOrigin
from labrig.record.events import FrameLine
from labrig.vision.picture import Picture
from labrig.vision.plane import PlaneMap
from tests.analysis.synthetic import ORIGIN_PX, PX_PER_MM, SIZE, needle_picture

PLANE = PlaneMap.from_scale(PX_PER_MM, ORIGIN_PX, "right", SIZE)


def sheath_picture(moved_px: int) -> NDArray[np.uint8]:
    """Draw the sheath alone, its tip shifted by this many pixels."""
    return np.roll(needle_picture(None), moved_px, axis=1)


def origins(
    moved_px: Sequence[int],
    linear_mm: Sequence[float],
    limits: SheathOrigin | None = None,
    turned_deg: Sequence[float] | None = None,
) -> tuple[TrialOrigin, ...]:
    """Return the origin found for each of these trials."""
    lines = [
        FrameLine(frame=2 * trial, file="", trial=trial, linear_mm=travel)
        for trial, travel in enumerate(linear_mm)
    ]
    turns = turned_deg or [0.0] * len(moved_px)
    return find_origins(
        lambda frame: turn_picture(sheath_picture(moved_px[frame // 2]), turns[frame // 2]),
        lines,
        PLANE,
        Sheath(depth_mm=15.0, speed_mm_s=5.0, diameter_mm=2.0, origin=limits),
    )


def turn_picture(image: NDArray[np.uint8], degrees: float) -> NDArray[np.uint8]:
    """Return the picture from a camera that is turned about the origin."""
    if not degrees:
        return image
    about = cv2.getRotationMatrix2D(ORIGIN_PX, degrees, 1.0)
    seen = cv2.warpAffine(image, about, SIZE, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen, dtype=np.uint8)


def test_sheath_is_found_where_it_stands() -> None:
    """Tip, pixel and direction of each trial, with the travel that the encoder read, none refused."""
    found = origins([0, 0, 0], [15.0, 15.0, 15.0], SheathOrigin())
    for trial, origin in enumerate(found):
        assert origin.trial == trial
        assert origin.tip_mm == pytest.approx((0.0, 0.05), abs=0.05)
        assert origin.tip_px == pytest.approx(ORIGIN_PX, abs=0.1 * PX_PER_MM)
        assert origin.heading_rad == pytest.approx(0.0, abs=0.01)
        assert (origin.linear_mm, origin.expected_mm) == (15.0, (0.0, 0.0))
        assert origin.accepted
        assert origin.disagreement_mm < 0.1
        assert origin.from_others_mm < 0.1


@pytest.mark.parametrize(
    ("moved_px", "words"),
    [(10, ("1.0", "beyond", "linear encoder", "slipped")), (-10, ("short of", "slipped"))],
)
def test_the_first_trial_alone_can_be_refused_along_the_insertion(
    moved_px: int, words: Sequence[str]
) -> None:
    """A slip of a millimetre is refused even in a run of one trial: origin and encoder give the expected tip."""
    (only,) = origins([moved_px], [15.0], SheathOrigin())
    assert not only.accepted
    assert only.along_mm == pytest.approx(0.1 * moved_px, abs=0.1)
    assert all(word in (only.reason or "") for word in words)
    assert origins([moved_px], [15.0])[0].accepted


def test_the_depth_that_belongs_to_the_origin_may_be_another_than_the_sheaths() -> None:
    """With the origin named for a depth of 16 mm the tip is expected a millimetre before it at 15 mm."""
    (only,) = origins([-10], [15.0], SheathOrigin(depth_mm=16.0))
    assert only.accepted
    assert only.expected_mm == pytest.approx((0.0, -1.0))


def _show(picture: Picture, _frame: int) -> Picture:
    return picture


def test_play_across_the_sheath_is_no_disagreement_and_a_bump_is() -> None:
    """Across, 0.7 mm is play and 3 mm is a bumped camera, either way; the encoder is not mentioned."""
    for aside_px, fine in ((7, True), (-7, True), (30, False), (-30, False)):
        image = np.roll(sheath_picture(0), -aside_px, axis=0)
        line = FrameLine(frame=0, file="", trial=0, linear_mm=15.0)
        sheath = Sheath(depth_mm=15.0, speed_mm_s=5.0, diameter_mm=2.0, origin=SheathOrigin())
        (origin,) = find_origins(partial(_show, image), [line], PLANE, sheath)
        assert origin.across_mm == pytest.approx(0.1 * aside_px, abs=0.05)
        assert origin.accepted is fine
        assert fine or "play" in (origin.reason or "")
        assert "slipped" not in (origin.reason or "")


def test_turned_camera_is_refused() -> None:
    """A turn of four degrees is refused in degrees, half a degree is play."""
    fine, refused = origins([0, 0], [15.0, 15.0], SheathOrigin(), turned_deg=[0.5, 4.0])
    assert fine.accepted
    assert fine.heading_rad == pytest.approx(np.radians(0.5), abs=0.005)
    assert not refused.accepted
    assert "4.0 degrees" in (refused.reason or "")
    assert "camera was turned" in (refused.reason or "")


def test_sheath_that_stands_elsewhere_than_its_encoder_says_is_refused() -> None:
    """The trial is named with the distance, and its radii are refused with the reason; the others are kept."""
    found = origins([0, round(2.0 * PX_PER_MM), 0, 0], [15.0] * 4)
    assert [origin.accepted for origin in found] == [True, False, True, True]
    assert found[1].disagreement_mm == pytest.approx(2.0, abs=0.1)
    assert "linear encoder and the other trials" in (found[1].reason or "")
    pictures = [complete_picture(picture(origin.trial), origin, None) for origin in found]
    assert [measurement.accepted for measurement in pictures] == [True, False, True, True]
    assert pictures[1].reason == found[1].reason


def test_slip_that_a_zero_set_by_eye_hides_is_found_by_the_other_trials() -> None:
    """All stand 0.4 mm beyond the origin but one, 0.3 mm short of it: within the limit, and 0.7 mm from its like."""
    found = origins([4, 4, 4, -3, 4], [15.0] * 5, SheathOrigin())
    assert [origin.accepted for origin in found] == [True, True, True, False, True]
    assert "the other trials" in (found[3].reason or "")


def test_sheath_that_went_as_far_as_its_encoder_says_is_no_other() -> None:
    """A trial with another travel is expected where that travel puts it."""
    found = origins([0, round(2.0 * PX_PER_MM), 0, 0], [15.0, 17.0, 15.0, 15.0], SheathOrigin())
    assert all(origin.accepted for origin in found)


def test_sheath_that_is_not_seen_is_said_so() -> None:
    """A trial without a visible sheath has a reason in place of an origin, and its radius is not refused."""
    lines = [FrameLine(frame=0, file="", trial=0, linear_mm=15.0)]
    sheath = Sheath(depth_mm=15.0, speed_mm_s=5.0, diameter_mm=2.0)
    found = find_origins(lambda _: np.full(SIZE[::-1], 160, np.uint8), lines, PLANE, sheath)
    assert not found[0].accepted
    assert "not found in frame 0" in (found[0].reason or "")
    assert complete_picture(picture(0), found[0], None).accepted


def test_tip_is_told_from_the_origin_of_its_trial() -> None:
    """The tip is relative to the pose of its trial's sheath; an imported picture uses its own sheath."""
    (found,) = origins([20], [15.0], turned_deg=[3.0])
    heading = found.heading_rad
    along = np.array([np.sin(heading), np.cos(heading)])
    aside = np.array([np.cos(heading), -np.sin(heading)])
    tip = np.array(found.tip_mm) + 30.0 * along - 4.0 * aside
    measured = picture(0).model_copy(update={"tip_mm": tuple(tip.tolist())})
    shifted = complete_picture(measured, found, None)
    assert shifted.tip_from_origin_mm == pytest.approx((-4.0, 30.0))
    assert (shifted.origin_mm, shifted.origin_heading_rad) == (found.tip_mm, heading)
    imported = measured.model_copy(
        update={"trial": None, "sheath_tip_mm": (1.0, 2.0), "sheath_heading_rad": 0.0, "tip_mm": (0.0, 32.0)}
    )
    assert complete_picture(imported, None, None).tip_from_origin_mm == pytest.approx((-1.0, 30.0))


@given(
    st.tuples(*[st.floats(-50, 50)] * 2),
    st.tuples(*[st.floats(-50, 50)] * 2),
    st.floats(-1.5, 1.5),
)
def test_distances_are_the_same_from_every_origin(
    point: tuple[float, float], origin: tuple[float, float], heading: float
) -> None:
    """Another frame changes no length, and the origin of its own frame is zero."""
    shifted = to_origin_frame(point, origin, heading)
    assert np.hypot(*shifted) == pytest.approx(np.hypot(point[0] - origin[0], point[1] - origin[1]), abs=1e-9)
    assert to_origin_frame(origin, origin, heading) == (0.0, 0.0)


def picture(trial: int) -> PictureResult:
    """Return an accepted picture of a trial."""
    return PictureResult(
        frame=2 * trial + 1,
        image="x.png",
        role="final",
        trial=trial,
        specimen="gel",
        gelatin_percent=10.0,
        hole=0,
        needle_id="N1",
        insertion_mm=40.0,
        found=True,
        accepted=True,
        reason=None,
    )
