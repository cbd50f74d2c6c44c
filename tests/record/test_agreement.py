"""Agreement of what was computed again with what is recorded."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.record.agreement import Agreement, Verdict

NUMBERS = st.floats(-1e6, 1e6)
DOCUMENTS = st.recursive(
    st.none() | st.booleans() | st.integers() | NUMBERS | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=12,
)


def judge(recorded: object, now: object) -> Agreement:
    """Compare two documents."""
    agreement = Agreement()
    agreement.compare("document", recorded, now)
    return agreement


@given(DOCUMENTS)
def test_a_document_is_identical_to_itself(document: object) -> None:
    """Whatever it holds."""
    found = judge(document, document)
    assert (found.verdict, found.largest, found.first) == (Verdict.IDENTICAL, {}, None)


@pytest.mark.parametrize(
    ("recorded", "now", "verdict"),
    [
        # a tenth of the standard deviation that stands beside it
        ({"radius_mm": 28.0, "sigma_radius_mm": 0.5}, {"radius_mm": 28.049, "sigma_radius_mm": 0.5}, "equivalent"),
        ({"radius_mm": 28.0, "sigma_radius_mm": 0.5}, {"radius_mm": 28.051, "sigma_radius_mm": 0.5}, "different"),
        ({"heading_rad": 0.1, "heading_sd_rad": 0.04}, {"heading_rad": 0.1039, "heading_sd_rad": 0.04}, "equivalent"),
        ({"heading_rad": 0.1, "heading_sd_rad": 0.04}, {"heading_rad": 0.1041, "heading_sd_rad": 0.04}, "different"),
        ({"fx": 500.0, "sigma": {"fx": 1.0}}, {"fx": 500.099, "sigma": {"fx": 1.0}}, "equivalent"),
        ({"fx": 500.0, "sigma": {"fx": 1.0}}, {"fx": 500.101, "sigma": {"fx": 1.0}}, "different"),
        # what the unit allows
        ({"tip_mm": [1.0, 2.0]}, {"tip_mm": [1.0099, 2.0]}, "equivalent"),
        ({"tip_mm": [1.0, 2.0]}, {"tip_mm": [1.0101, 2.0]}, "different"),
        # a share of the largest number of the list
        ({"matrix": [1e-6, 2.0]}, {"matrix": [0.0019, 2.0]}, "equivalent"),
        ({"matrix": [1e-6, 2.0]}, {"matrix": [0.0021, 2.0]}, "different"),
        # sentences: the last digit that they write
        ({"cause": "the tip is 0.09 mm away"}, {"cause": "the tip is 0.10 mm away"}, "equivalent"),
        ({"cause": "the tip is 0.09 mm away"}, {"cause": "the tip is 0.11 mm away"}, "different"),
        ({"plan": "3 arcs"}, {"plan": "4 arcs"}, "different"),
        ({"cause": "reached"}, {"cause": "missed"}, "different"),
        # decisions
        ({"arcs": 3}, {"arcs": 4}, "different"),
        ({"accepted": True}, {"accepted": False}, "different"),
        ({"radius_mm": None}, {"radius_mm": 28.0}, "different"),
        ({"arcs": [1.0]}, {"arcs": [1.0, 1.0]}, "different"),
        ({"a": 1}, {"a": 1, "b": 2}, "different"),
    ],
)  # fmt: skip
def test_each_value_has_its_tolerance(recorded: object, now: object, verdict: str) -> None:
    """A row just inside and a row just outside for each kind of value."""
    assert str(judge(recorded, now).verdict) == verdict


def test_the_largest_difference_of_each_quantity_is_kept() -> None:
    """Items of a list count as one quantity; the first one beyond its tolerance is named."""
    found = judge({"tips_mm": [1.0, 2.0, 3.0]}, {"tips_mm": [1.001, 2.5, 3.7]})
    assert found.largest == {"document.tips_mm.*": pytest.approx(0.7)}
    assert found.beyond == 2
    assert (found.first.recorded, found.first.now) == (2.0, 2.5)
    beside = {"sigma_radius_mm": 0.5}
    found = judge({"radius_mm": 28.0, **beside}, {"radius_mm": 28.025, **beside})
    assert (found.in_sd, found.shares) == (
        {"document.radius_mm": pytest.approx(0.05)},
        {"document.radius_mm": pytest.approx(0.5)},
    )
