"""Whether a picture is fit to be measured: focus, saturation, exposure, and flicker over several pictures.

Focus is the width of the edges: the contrast across an edge over its steepest slope, in pixels. A step that a Gaussian
of standard deviation s blurs is 2.5 s wide; a sharp one is 2 px wide, as slopes are taken over two pixels. A thin line
is a step up and a step down, and its edges are a third narrower. The median of the strongest edges is stated, so noise
in even grey and soft reflections take no part.

Flicker is the variation of the mean brightness, without its slow drift. Lamps on the mains flicker with twice its
frequency; pictures at a lower rate show a beat of that.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from labrig.vision.picture import Picture, as_grey

_SATURATED, _BLACK = 254, 1
# Standard deviation of the smoothing before slopes are taken [px], and reach around an edge in which its contrast lies.
_SMOOTH_PX, _REACH_PX = 0.7, 10
# Slope of noise of one grey level after that smoothing, and how far an edge is steeper.
_NOISE_SLOPE, _STEEPER = 0.25, 8.0
_LEAST_SLOPE, _LEAST_CONTRAST = 2.0, 20.0
# Edges less steep than this share of a high quantile take no part; fewer edges than that say nothing.
_STRONG, _STEEPEST, _FEWEST_EDGES = 0.5, 0.99, 50
_FEWEST_FOR_FLICKER = 8


def measure_edge_width(grey: Picture) -> float | None:
    """Return the median width [px] of the strongest edges of a picture (H, W); None if there are too few."""
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _SMOOTH_PX)
    du, dv = (cv2.Scharr(smooth, cv2.CV_32F, *order, scale=1 / 32) for order in ((1, 0), (0, 1)))
    slope = cv2.magnitude(du, dv)
    least = max(_LEAST_SLOPE, _STEEPER * _NOISE_SLOPE * _estimate_noise(grey))
    window = np.ones((2 * _REACH_PX + 1,) * 2, np.uint8)
    contrast = cv2.dilate(smooth, window) - cv2.erode(smooth, window)
    crest = slope >= cv2.dilate(slope, np.ones((3, 3), np.uint8)) - 1e-6
    # Where the picture saturates, the top of an edge is cut off, and it looks sharper than it is.
    whole = cv2.dilate(grey, window) < _SATURATED
    edges = crest & whole & (slope >= least) & (contrast >= _LEAST_CONTRAST)
    if np.count_nonzero(edges) < _FEWEST_EDGES:
        return None
    strong = edges & (slope >= _STRONG * np.quantile(slope[edges], _STEEPEST))
    return float(np.median(contrast[strong] / slope[strong]))


def _estimate_noise(grey: Picture) -> float:
    """Return the standard deviation of the noise (Immerkaer, Computer Vision and Image Understanding, 1996)."""
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    return float(np.sqrt(0.5 * np.pi) * np.abs(cv2.filter2D(grey, cv2.CV_32F, mask)).mean() / 6.0)


def measure_flicker(times_s: Sequence[float], means: Sequence[float]) -> float | None:
    """Return the standard deviation, over the mean, of the mean grey levels of successive pictures, drift apart.

    None for fewer than eight pictures.
    """
    t_s, grey = np.asarray(times_s, float), np.asarray(means, float)
    if len(grey) < _FEWEST_FOR_FLICKER or not grey.mean() > 0.0:
        return None
    drift = np.polynomial.Polynomial.fit(t_s, grey, 1)(t_s) if np.ptp(t_s) > 0.0 else grey.mean()
    return float((grey - drift).std() / grey.mean())


# Of eight drawn insertions at 0.065 mm a pixel, with more and more blur, radii are 0.03 mm off at edges of 5.8 px, the
# first is refused at 6.7 px, five at 7.7 px. The others are conventional: room for noise and uneven light above, grey
# levels enough to place an edge below.
_LIMITS: Mapping[str, tuple[float, float, str, str]] = {
    "focus": (0.0, 6.0, " px", "edges are {:.1f} px wide"),
    "saturation": (0.0, 1.0, " %", "{:.1f} % of the pixels are saturated"),
    "black": (0.0, 1.0, " %", "{:.1f} % of the pixels are black"),
    "exposure": (50.0, 220.0, "", "median grey level {:.0f}"),
    "flicker": (0.0, 2.0, " %", "brightness varies by {:.1f} %"),
}
"""Least and largest value, their unit, and what is told of a value."""

_DARKEN = "shorten the exposure, or dim the light"
_BRIGHTEN = "lengthen the exposure, or add light"
_SHARPEN = "turn the lens, or change camera.focus in the rig file; then calibrate again"
_STEADY = "set camera.mains_hz, expose for a multiple of half a mains period, or use a steady lamp"


@dataclass(frozen=True)
class Score:
    """A quantity of pictures beside its limit.

    Attributes
    ----------
    name : str
        focus, saturation, black, exposure, or flicker.
    value : float or None
        In the unit of the limit; None if it is not known.
    limit : str
        As a person reads it, such as `at most 1 %`.
    good : bool or None
        Whether the value is within the limit; None if it is not known.
    text : str
        The value as a person reads it, or why it is not known.
    hint : str
        What to do where it is beyond.
    """

    name: str
    value: float | None
    limit: str
    good: bool | None
    text: str
    hint: str = ""


def judge_picture(image: Picture, flicker: float | None) -> tuple[Score, ...]:
    """Return the scores of a picture, (H, W) or (H, W, 3), and of the flicker in those before it."""
    grey = as_grey(image)
    shares = np.cumsum(np.bincount(grey.ravel(), minlength=256)) / grey.size
    median = float(np.searchsorted(shares, 0.5))
    aside = _BRIGHTEN if median < _LIMITS["exposure"][0] else _DARKEN
    return (
        _judge("focus", measure_edge_width(grey), _SHARPEN, "no sharp edges: show graph paper or the needle"),
        _judge("saturation", 100.0 * float(1.0 - shares[_SATURATED - 1]), _DARKEN),
        _judge("black", 100.0 * float(shares[_BLACK]), _BRIGHTEN),
        _judge("exposure", median, aside),
        _judge(
            "flicker",
            None if flicker is None else 100.0 * flicker,
            _STEADY,
            f"known from {_FEWEST_FOR_FLICKER} pictures on",
        ),
    )


def _judge(name: str, value: float | None, hint: str, unknown: str = "") -> Score:
    least, most, unit, text = _LIMITS[name]
    limit = (f"{least:g} to {most:g}" if least else f"at most {most:g}") + unit
    if value is None:
        return Score(name, None, limit, None, unknown)
    good = least <= value <= most
    return Score(name, value, limit, good, text.format(value), "" if good else hint)
