"""The curvature in a specimen over its age and the number of the track."""

from random import Random

import pytest

from labrig.experiments.shared.specimen_result import (
    describe_trend,
    fit_trends,
    map_specimens,
    summarise_maps,
)
from labrig.protocol.sections import TrackedSpecimen
from labrig.protocol.specimen_file import SpecimenTrack
from tests.protocol.specimens import make_section, make_track


def tracks(percent_per_h: float, needle_id: str = "N1") -> list[SpecimenTrack]:
    """Return a track each two hours, with a curvature that drifts and scatters by 0.3 %."""
    random = Random(7)
    curvatures = [(1 + 0.01 * percent_per_h * 2 * hour + random.gauss(0, 0.003)) / 28 for hour in range(12)]
    return [
        make_track(age_h=20.0 + 2 * hour, radius_mm=1 / curvature, needle_id=needle_id)
        for hour, curvature in enumerate(curvatures)
    ]


def test_a_drift_is_told_with_its_interval() -> None:
    """0.4 % an hour over 22 hours is found within its interval, by age and by number, and is called a drift."""
    age, number = fit_trends(tracks(0.4), "N1")
    low, high = (100 * bound * 28 for bound in age.slope_ci95)
    assert low < 0.4 < high
    assert (age.drifts, number.drifts, age.n, age.span) == (True, True, 12, 22.0)
    assert age.change_percent == pytest.approx(0.4 * 22 / 1.044, rel=0.1)
    assert "above 2 %, and significant" in describe_trend(age)


def test_scatter_and_other_needles_are_no_drift() -> None:
    """Without a drift none is told of, one below the limit is told as none, and another needle does not count."""
    assert [trend.drifts for trend in fit_trends(tracks(0.0), "N1")] == [False, False]
    small = fit_trends(tracks(0.06), "N1")[0]
    assert (small.p < 0.05, small.drifts) == (True, False)
    mixed = [*tracks(0.0), *(track.model_copy(update={"radius_mm": 60.0}) for track in tracks(0.0, "N2"))]
    assert fit_trends(mixed, "N1") == fit_trends(tracks(0.0), "N1")


def test_the_terminal_tells_the_next_hole_and_a_drift() -> None:
    """A result as its file holds it gives a line for the specimen, and one for each trend that drifts."""
    gel = TrackedSpecimen(name="A1", gelatin_percent=10.0, block=make_section(*tracks(0.4)))
    (found,) = map_specimens({"specimens.0": gel}, {}, 2.0, 100.0, "N1")
    line, *warnings = summarise_maps([found.model_dump(mode="json")])
    assert line == "specimen A1  12 tracks, next clear hole at first_hole_mm: 4"
    assert len(warnings) == 2
    assert all(warning.startswith("warning: The curvature changes by +") for warning in warnings)


def test_too_few_tracks_have_no_trend() -> None:
    """Two radii, or radii of one age, say nothing of a drift over it."""
    assert fit_trends(tracks(0.4)[:2], "N1") == ()
    same_age = [track.model_copy(update={"age_h": 24.0}) for track in tracks(0.4)]
    assert [trend.over for trend in fit_trends(same_age, "N1")] == ["track"]
