"""The first difference of two results."""

from typing import Any

from labrig.analysis.divergence import Divergence, find_divergence


def _document(**changes: Any) -> dict[str, Any]:
    return {
        "created": "now", "parent": None, "settings": {"window_start_mm": 4.0}, "mean_radius_mm": 27.5,
        "specimens": [{"n": 2, "mean_radius_mm": 27.5}],
        "measurements": [{"frame": 3, "radius_mm": 27.0, "tip_mm": [1.0, 2.0]}, {"frame": 7, "radius_mm": 28.0}],
    } | changes  # fmt: skip


def test_results_that_say_the_same_do_not_part() -> None:
    """Time, parent and settings of a result do not count as differences."""
    assert find_divergence(_document(), _document(created="later", parent=1, settings={})) is None


def test_the_first_picture_that_differs_is_named() -> None:
    """Pictures are compared before the values computed from them, and the frame is named."""
    pictures = [{"frame": 3, "radius_mm": 27.0, "tip_mm": [1.0, 2.0]}, {"frame": 7, "radius_mm": 28.5}]
    new = _document(mean_radius_mm=27.75, measurements=pictures)
    assert find_divergence(_document(), new) == Divergence("measurements.1.radius_mm", 7, 28.0, 28.5)


def test_a_picture_that_is_gone_and_a_sum_that_differs_are_named() -> None:
    """A value that one result lacks is None; a value without a picture has no frame."""
    fewer = _document(measurements=_document()["measurements"][:1])
    assert find_divergence(_document(), fewer) == Divergence("measurements.1.frame", 7, 7, None)
    other = _document(mean_radius_mm=1.0)
    assert find_divergence(_document(), other) == Divergence("mean_radius_mm", None, 27.5, 1.0)


def test_of_a_sentence_only_counts_whether_it_is_there() -> None:
    """A changed reason is no difference; a newly refused picture is."""
    refused = _document(measurements=[{"frame": 3, "reason": "4 mm are left out"}])
    other = _document(measurements=[{"frame": 3, "reason": "6 mm are left out"}])
    assert find_divergence(refused, other) is None
    accepted = _document(measurements=[{"frame": 3, "reason": None}])
    assert find_divergence(refused, accepted) == Divergence(
        "measurements.0.reason", 3, "4 mm are left out", None
    )
