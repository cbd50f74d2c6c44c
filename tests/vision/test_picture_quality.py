"""Focus, saturation, exposure and flicker of pictures."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from labrig.vision.picture_quality import judge_picture, measure_edge_width, measure_flicker


def _disc(blur_px: float, noise_sd: float = 2.0) -> NDArray[np.uint8]:
    """Draw a bright disc on dark ground."""
    v, u = np.mgrid[:300, :400]
    sharp = np.where(np.hypot(u - 200, v - 150) < 90, 170.0, 60.0).astype(np.float32)
    noise = np.random.default_rng(3).normal(0.0, noise_sd, sharp.shape)
    return np.clip(cv2.GaussianBlur(sharp, (0, 0), blur_px) + noise, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("blur_px", [2.0, 3.0, 4.0])
def test_the_width_of_an_edge_is_two_and_a_half_times_its_blur(blur_px: float) -> None:
    """The width of a blurred step is that of its Gaussian within a fifth, whatever its contrast."""
    for image in (_disc(blur_px), _disc(blur_px) // 2 + 60):
        width_px = measure_edge_width(image)
        assert width_px == pytest.approx(np.sqrt(2 * np.pi) * np.hypot(blur_px, 0.7), rel=0.2)


def test_noise_and_even_grey_have_no_focus() -> None:
    """Neither shows an edge, so that the score is not known."""
    noise = np.random.default_rng(1).normal(120.0, 6.0, (300, 400)).astype(np.uint8)
    for image in (noise, np.full((300, 400), 120, np.uint8)):
        assert measure_edge_width(image) is None
    (focus, *_) = judge_picture(noise, None)
    assert (focus.value, focus.good) == (None, None)
    assert "graph paper" in focus.text


def test_a_blurred_saturated_picture_is_told_what_to_do() -> None:
    """Each score beyond its limit states value, limit and remedy; the median grey has room on both sides."""
    image = _disc(5.0)
    image[:30] = 255
    scores = {score.name: score for score in judge_picture(image, 0.031)}
    assert [name for name, score in scores.items() if not score.good] == ["focus", "saturation", "flicker"]
    assert list(scores) == ["focus", "saturation", "black", "exposure", "flicker"]
    assert scores["saturation"].text == "10.0 % of the pixels are saturated"
    assert scores["saturation"].limit == "at most 1 %"
    assert "shorten the exposure" in scores["saturation"].hint
    assert scores["flicker"].text == "brightness varies by 3.1 %"
    assert not scores["black"].hint
    for grey, hint in ((20, "lengthen"), (240, "shorten")):
        exposed = judge_picture(np.full((50, 50, 3), grey, np.uint8), None)
        assert hint in next(score.hint for score in exposed if score.name == "exposure")


def test_flicker_is_found_and_drift_is_none() -> None:
    """A beat in pictures of uneven times is found within a tenth; a lamp that warms up does not flicker."""
    times_s = np.arange(40) / 24 + np.random.default_rng(2).normal(0, 0.002, 40)
    flicker = measure_flicker(times_s.tolist(), (100 + 5 * np.sin(2 * np.pi * 4 * times_s)).tolist())
    assert flicker == pytest.approx(0.05 / np.sqrt(2), rel=0.1)
    assert measure_flicker(times_s.tolist(), (100 + 3 * times_s).tolist()) < 1e-9
    assert measure_flicker(times_s[:8].tolist(), [100.0] * 8) == pytest.approx(0.0)
    assert measure_flicker(times_s[:7].tolist(), [100.0] * 7) is None
