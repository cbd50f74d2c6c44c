"""Where the sheath stood in each trial, and trials in which it was somewhere else."""

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from labrig.analysis.origin import find_origins, refused_by_origin
from labrig.analysis.result import PictureResult, TrialOrigin
from labrig.vision import PlaneMap
from tests.analysis.synthetic import ORIGIN_PX, PX_PER_MM, SIZE, needle_picture

PLANE = PlaneMap.from_scale(PX_PER_MM, ORIGIN_PX, "right", SIZE)
SHEATH_MM = 2.0


def sheath_picture(moved_px: int) -> NDArray[np.uint8]:
    """Draw the sheath alone, its tip so many pixels further on than in the other pictures."""
    return np.roll(needle_picture(None), moved_px, axis=1)


def origins(moved_px: Sequence[int], linear_mm: Sequence[float]) -> tuple[TrialOrigin, ...]:
    """Return what is found in a trial for each of these."""
    lines = [
        {"frame": 2 * trial, "trial": trial, "role": "sheath", "linear_mm": travel}
        for trial, travel in enumerate(linear_mm)
    ]
    return find_origins(lambda frame: sheath_picture(moved_px[frame // 2]), lines, PLANE, SHEATH_MM)


def test_sheath_is_found_where_it_stands() -> None:
    """Tip, pixel and direction of each trial, with the travel that the encoder read, none refused."""
    found = origins([0, 0, 0], [15.0, 15.0, 15.0])
    for trial, one in enumerate(found):
        assert one.trial == trial
        assert one.tip_mm == pytest.approx((0.0, 0.3), abs=0.2)
        assert one.tip_px == pytest.approx(ORIGIN_PX, abs=0.5 * PX_PER_MM)
        assert one.heading_rad == pytest.approx(0.0, abs=0.02)
        assert one.linear_mm == 15.0
        assert one.accepted
        assert one.disagreement_mm < 0.1


def test_sheath_that_stands_elsewhere_than_its_encoder_says_is_refused() -> None:
    """The trial is named with the distance, and its radii are refused with the reason; the others stand."""
    found = origins([0, round(2.0 * PX_PER_MM), 0, 0], [15.0] * 4)
    assert [one.accepted for one in found] == [True, False, True, True]
    assert found[1].disagreement_mm == pytest.approx(2.0, abs=0.1)
    assert "linear encoder" in found[1].reason
    pictures = refused_by_origin([picture(trial) for trial in range(4)], found)
    assert [one.accepted for one in pictures] == [True, False, True, True]
    assert pictures[1].reason == found[1].reason


def test_sheath_that_went_as_far_as_its_encoder_says_is_no_other() -> None:
    """A trial with another travel stands where that travel puts it."""
    found = origins([0, round(2.0 * PX_PER_MM), 0, 0], [15.0, 17.0, 15.0, 15.0])
    assert all(one.accepted for one in found)


def test_sheath_that_is_not_seen_is_said_so() -> None:
    """Such a trial has no origin, with the reason, and refuses nobody's radius."""
    lines = [{"frame": 0, "trial": 0, "role": "sheath", "linear_mm": 15.0}]
    found = find_origins(lambda _: np.full(SIZE[::-1], 160, np.uint8), lines, PLANE, SHEATH_MM)
    assert not found[0].accepted
    assert "not found in frame 0" in (found[0].reason or "")
    assert refused_by_origin([picture(0)], found)[0].accepted
    assert find_origins(sheath_picture, lines, PLANE, None) == ()


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
