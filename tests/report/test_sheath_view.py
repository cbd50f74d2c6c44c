"""The enlarged end of a sheath, with its pose as found and as commanded."""

from pathlib import Path

import pytest

from labrig.analysis.result import TrialOrigin
from labrig.record.reader import open_run
from labrig.report.sheath_view import draw_sheath_view
from labrig.vision.plane import PlaneMap
from tests.record.runs import closed_run

PLANE = PlaneMap.from_scale(2.0, (16.0, 12.0), "right", (32, 24))


@pytest.mark.parametrize("above_mm", [0.4, -0.4])
def test_each_name_stands_on_the_side_of_its_own_arrow(tmp_path: Path, above_mm: float) -> None:
    """Whether the sheath was found above or below the command, in a picture with +y upwards."""
    origin = TrialOrigin(
        trial=0,
        frame=1,
        tip_mm=(above_mm, 0.0),
        tip_px=(16.0, 12.0 - 2.0 * above_mm),
        heading_rad=0.0,
        expected_mm=(0.0, 0.0),
        accepted=True,
    )
    view = draw_sheath_view(open_run(closed_run(tmp_path)), origin, PLANE)
    assert view is not None
    assert view.commanded is not None
    is_found_above = view.found.end[1] < view.commanded.end[1]
    assert (view.found.label[1] < view.commanded.label[1]) is is_found_above
    assert is_found_above is (above_mm > 0)
