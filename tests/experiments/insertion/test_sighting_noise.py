"""What an insertion's result says of its sightings: measured noise, and an alarm where the protocol states another."""

import re

import pytest

from labrig.experiments.insertion.result import describe_sighting_noise
from tests.experiments.insertion.recorded import analyse_recorded

_NOISE = {
    "mean_nis": 2.0, "usual_nis": (1.4, 2.7), "verdict": "as expected", "stated_observation_sd_mm": 0.2,
    "advised_observation_sd_mm": 0.05,
}  # fmt: skip


def test_the_sightings_of_a_record_tell_their_noise() -> None:
    """The tip is seen to a few hundredths of a millimetre, and less than a template's bias is not advised."""
    noise = analyse_recorded().sighting_noise
    assert noise is not None
    assert noise.observation_sd_mm is not None
    assert 0.003 < noise.observation_sd_mm < 0.05
    assert noise.advised_observation_sd_mm == 0.05
    assert noise.stated_observation_sd_mm == 0.05


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({}, None),
        ({"verdict": "too small", "mean_nis": 0.04}, "seen better than .* 0.2 says; 0.05 would fit"),
        ({"verdict": "too small", "stated_observation_sd_mm": 0.05}, None),
        (
            {"verdict": "too large", "advised_observation_sd_mm": 0.4},
            "seen worse than .* 0.2 says; 0.4 would",
        ),
        ({"verdict": "too large"}, "the needle moves otherwise than radius_mm"),
        ({"verdict": "too large", "advised_observation_sd_mm": None}, "the needle moves otherwise"),
    ],
)
def test_a_nis_out_of_its_range_names_what_to_state(change: dict[str, object], told: str | None) -> None:
    """Both ways, and not where the protocol states what is advised already."""
    sentence = describe_sighting_noise(_NOISE | change)
    assert (sentence is None) == (told is None)
    assert told is None or re.search(told, str(sentence))
