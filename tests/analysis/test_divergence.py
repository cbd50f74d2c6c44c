"""The agreement of two results of one run."""

from typing import Any

from labrig.analysis.divergence import compare_results, find_frame
from labrig.record.agreement import Deviation, Verdict


def _document(**changes: Any) -> dict[str, Any]:
    return {
        "created": "now", "parent": None, "settings": {"window_start_mm": 4.0}, "mean_radius_mm": 27.5,
        "specimens": [{"n": 2, "mean_radius_mm": 27.5}],
        "measurements": [{"frame": 3, "radius_mm": 27.0, "tip_mm": [1.0, 2.0]}, {"frame": 7, "radius_mm": 28.0}],
    } | changes  # fmt: skip


def test_results_that_say_the_same_are_identical() -> None:
    """Time, parent and settings of a result do not count as differences."""
    found = compare_results(_document(), _document(created="later", parent=1, settings={}))
    assert found.verdict is Verdict.IDENTICAL


def test_the_first_picture_that_differs_is_named() -> None:
    """Pictures are compared before the values computed from them, and the frame is found."""
    pictures = [{"frame": 3, "radius_mm": 27.0, "tip_mm": [1.0, 2.0]}, {"frame": 7, "radius_mm": 28.5}]
    new = _document(mean_radius_mm=27.75, measurements=pictures)
    found = compare_results(_document(), new)
    assert found.first == Deviation("measurements.1.radius_mm", 28.0, 28.5, 0.5, 0.01)
    assert find_frame("measurements.1.radius_mm", new) == 7


def test_a_picture_that_is_gone_and_a_mean_that_differs_are_named() -> None:
    """A value that one result lacks is None; a value without a picture has no frame."""
    fewer = _document(measurements=_document()["measurements"][:1])
    gone = {"frame": 7, "radius_mm": 28.0}
    assert compare_results(_document(), fewer).first == Deviation("measurements.1", gone, None)
    assert find_frame("measurements.1", _document()) == 7
    other = compare_results(_document(), _document(mean_radius_mm=1.0))
    assert other.first == Deviation("mean_radius_mm", 27.5, 1.0, 26.5, 0.01)
    assert find_frame("mean_radius_mm", _document()) is None


def test_of_a_sentence_only_counts_whether_it_is_there() -> None:
    """A changed reason is no difference; a newly refused picture is."""
    refused = _document(measurements=[{"frame": 3, "reason": "4 mm are left out"}])
    other = _document(measurements=[{"frame": 3, "reason": "6 mm are left out"}])
    assert compare_results(refused, other).verdict is Verdict.IDENTICAL
    accepted = _document(measurements=[{"frame": 3, "reason": None}])
    assert compare_results(refused, accepted).first == Deviation("measurements.0.reason", True, None)
