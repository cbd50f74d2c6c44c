"""What an insertion's result says of its sightings: measured noise, and an alarm where the protocol states another."""

import re

import pytest

from labrig.experiments.insertion.result import describe_nis

_NOISE = {
    "mean_nis": 2.0, "usual_nis": (1.4, 2.7), "verdict": "as expected", "stated_observation_sd_mm": 0.2,
    "advised_observation_sd_mm": 0.05,
}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({}, None),
        ({"verdict": "too small", "mean_nis": 0.04}, "seen better than the stated 0.2 mm; 0.05 mm would fit"),
        ({"verdict": "too small", "stated_observation_sd_mm": 0.05}, None),
        ({"verdict": "too large", "advised_observation_sd_mm": 0.4}, "worse than .* 0.2 mm; 0.4 mm would fit"),
        ({"verdict": "too large", "advised_observation_sd_mm": 0.4, "mean_nis": 17.0}, "the needle moves otherwise"),
        ({"verdict": "too large", "mean_nis": 2.75}, "2.75, where 1.40 to 2.70 is usual: the needle moves otherwise"),
        ({"verdict": "too large", "advised_observation_sd_mm": None}, "the needle moves otherwise"),
    ],
)  # fmt: skip
def test_a_nis_out_of_its_range_names_what_to_state(change: dict[str, object], told: str | None) -> None:
    """Both ways, and not where the protocol states what is advised already."""
    sentence = describe_nis(_NOISE | change)
    assert (sentence is None) == (told is None)
    assert told is None or re.search(told, str(sentence))
