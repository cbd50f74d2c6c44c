"""A plane map against the last one of the same camera."""

from dataclasses import replace
from datetime import UTC, datetime

import pytest

from labrig.vision.plane import PlaneMap
from labrig.vision.scale_check import PlaneScale, compare_scales, refuse_other_scale

SIZE = (800, 480)
PLANE = PlaneMap.from_scale(8.0, (100.0, 240.0), "right", SIZE)
LAST = PlaneScale("bench-plane.json", datetime(2026, 10, 3, tzinfo=UTC), True, 0.125, (20.0, 30.0), SIZE)


def last_of(ratio):
    """Return a last map to which the scale of the new one has this ratio."""
    return replace(LAST, mm_per_px=0.125 / ratio)


@pytest.mark.parametrize(
    ("ratio", "advised", "confirmed"),
    [
        (1.01, False, False),
        (0.985, False, False),
        (1.07, True, False),
        (0.9, True, False),
        (1.27, False, True),
        (0.5, False, True),
        (0.2, False, True),
        (5.0, False, True),
        (10.0, False, True),
    ],
)
def test_a_change_of_scale_is_stated_and_that_of_other_lines_needs_a_person(ratio, advised, confirmed):
    """Both scales and their ratio are stated; above 2 % with what to do, and above a factor of 1.2 refused."""
    comparison = compare_scales(PLANE, last_of(ratio), camera_moved=False)
    assert comparison.ratio == pytest.approx(ratio)
    assert (
        f"0.12500 mm/px at (20, 30) px, {ratio:.3f} times the {0.125 / ratio:.5f} mm/px"
        in comparison.sentence
    )
    assert "bench-plane.json of 2026-10-03" in comparison.sentence
    assert (f"the picture is {99.875 / ratio:.0f} mm wide" in comparison.sentence) == (advised or confirmed)
    assert ("with a ruler" in comparison.sentence) == advised
    judged = refuse_other_scale(PLANE, comparison, "say so")
    assert judged.accepted != confirmed
    assert [reason.endswith("was changed, say so") for reason in judged.reasons] == [True] * confirmed


def test_a_moved_camera_may_have_any_scale():
    """If a person says that the camera was moved, the ratio is stated and nothing is refused."""
    comparison = compare_scales(PLANE, last_of(5.0), camera_moved=True)
    assert (comparison.ratio, comparison.needs_confirmation) == (pytest.approx(5.0), False)
    assert refuse_other_scale(PLANE, comparison, "").accepted


def test_a_refused_map_is_compared_and_named_as_refused():
    """The next map is compared with a refused one as well, so that a second attempt does not pass unnoticed."""
    comparison = compare_scales(PLANE, replace(last_of(5.0), accepted=False), camera_moved=False)
    assert comparison.needs_confirmation
    assert "bench-plane.json of 2026-10-03 (refused)" in comparison.sentence


def test_pictures_of_another_size_are_not_compared():
    """A map for pictures of another size gives no ratio, and the sentence says why."""
    comparison = compare_scales(PLANE, replace(LAST, image_size=(1280, 720)), camera_moved=False)
    assert (comparison.ratio, comparison.needs_confirmation) == (None, False)
    assert "for pictures of 1280 x 720 pixels, this one has 800 x 480" in comparison.sentence
