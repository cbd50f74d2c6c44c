"""The agreement of two results of one run."""

from typing import Any

import pytest

from labrig.analysis.divergence import compare_results, find_frame
from labrig.record.agreement import Deviation, Verdict

PICTURES = [{"frame": 3, "radius_mm": 27.0, "tip_mm": [1.0, 2.0]}, {"frame": 7, "radius_mm": 28.0}]


def _document(**changes: Any) -> dict[str, Any]:
    return {
        "created": "now", "parent": None, "settings": {"window_start_mm": 4.0}, "mean_radius_mm": 27.5,
        "specimens": [{"n": 2, "mean_radius_mm": 27.5}],
        "measurements": PICTURES,
    } | changes  # fmt: skip


REFUSED = [{"frame": 3, "reason": "4 mm are left out"}]


@pytest.mark.parametrize(
    ("old", "new", "first", "frame"),
    [
        ({}, {"created": "later", "parent": 1, "settings": {}}, None, None),
        # Pictures are compared before the values computed from them.
        ({}, {"mean_radius_mm": 27.75, "measurements": [PICTURES[0], {"frame": 7, "radius_mm": 28.5}]},
         Deviation("measurements.1.radius_mm", 28.0, 28.5, 0.5, 0.01), 7),
        # A value that one result lacks is None; a value without a picture has no frame.
        ({}, {"measurements": PICTURES[:1]}, Deviation("measurements.1", PICTURES[1], None), 7),
        ({}, {"mean_radius_mm": 1.0}, Deviation("mean_radius_mm", 27.5, 1.0, 26.5, 0.01), None),
        # Of a sentence only counts whether it is there.
        ({"measurements": REFUSED}, {"measurements": [{"frame": 3, "reason": "6 mm are left out"}]}, None, None),
        ({"measurements": REFUSED}, {"measurements": [{"frame": 3, "reason": None}]},
         Deviation("measurements.0.reason", True, None), 3),
    ],
    ids=["stamp", "picture", "picture gone", "mean", "another sentence", "no sentence"],
)  # fmt: skip
def test_the_first_value_that_differs_is_named_with_its_picture(old, new, first, frame):
    """Time, parent, settings and the words of a sentence do not count as differences."""
    recorded, now = _document(**old), _document(**new)
    found = compare_results(recorded, now)
    assert found.first == first
    assert (found.verdict is Verdict.IDENTICAL) == (first is None)
    assert first is None or find_frame(first.path, recorded) == frame
