"""How dark ruled lines are: the density of a picture without uneven light, and, if asked for, without pen traces.

A line shows most in the channel of the colour that its ink absorbs. On cream paper that is not the darkest channel, so
each channel counts by its own contrast over its own noise.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.vision.picture import Picture

Density = NDArray[np.float32]

# Slow changes of light are removed over this share of the picture's shorter side, and at least so many pixels.
_SLOW_SHARE, _LEAST_SLOW_PX = 1.0 / 40.0, 8.0
# It is taken from a smaller picture in which the smoothing has this size.
_COARSE_SIGMA_PX = 4.5
# Paper's edges, printed marks and pen traces are darker than lines; they are clipped at this quantile.
_CLIP_QUANTILE = 0.97
_CLIP_STRIDE = 4
# The ink without traces: a pixel darker than this quantile of the picture by this factor is a trace. It is removed with
# its surroundings, and the rest is smoothed.
_INK_QUANTILE, _TRACE = 0.93, 1.8
_TRACE_MARGIN_PX = 3
_INK_BLUR_PX = 2.0
_INK_SLOW_PX = 21
_MAD_TO_SIGMA = 1.4826
# Half a grey level of 200.
_LEAST_NOISE = 0.0025


def measure_darkness(image: Picture) -> Density:
    """Return the optical density (H, W) of the lines without uneven light."""
    channels = measure_channels(image)
    if len(channels) == 1:
        return channels[0]
    weights = np.array([_weigh_channel(channel) for channel in channels])
    weights /= weights.sum()
    mixed = sum(weight * channel for weight, channel in zip(weights, channels, strict=True))
    return np.asarray(mixed, dtype=np.float32)


def measure_channels(image: Picture) -> list[Density]:
    """Return the optical density (H, W) of the lines without uneven light in each channel."""
    channels = image[..., None] if image.ndim == 2 else image
    return [_remove_slow_light(_density(channels[..., number])) for number in range(channels.shape[2])]


def _weigh_channel(density: Density) -> float:
    """Return contrast over variance of noise, the weight of a channel in the sum with the least noise."""
    part = clip(density[::_CLIP_STRIDE])
    noise = _MAD_TO_SIGMA * float(np.median(np.abs(np.diff(part, axis=1)))) / 2.0**0.5
    noise = max(noise, _LEAST_NOISE)
    contrast = max(float(np.mean(part**2)) - noise**2, _LEAST_NOISE**2) ** 0.5
    return float(contrast / noise**2)


def measure_ink(image: Picture) -> Density:
    """Return the optical density (H, W) of the lines, darkness and colour together, without pen traces."""
    darkness = measure_darkness(image)
    level = float(np.quantile(darkness, _INK_QUANTILE))
    side = np.ones((_TRACE_MARGIN_PX, _TRACE_MARGIN_PX), np.uint8)
    trace = cv2.dilate((darkness > _TRACE * level).astype(np.uint8), side) > 0
    # Bytes suffice for the median: a hundredth of density is less than any line.
    bytes_ = np.clip(128.0 + 100.0 * darkness, 0, 255).astype(np.uint8)
    around = (cv2.medianBlur(bytes_, _INK_SLOW_PX).astype(np.float32) - 128.0) / 100.0
    ink = np.where(trace, around, np.minimum(darkness, level))
    if image.ndim == 3:
        colour = _remove_slow_light(_density(image[..., 1]) - _density(image[..., 2]))
        most = float(np.quantile(colour, _INK_QUANTILE))
        ink += np.where(trace, 0.0, np.clip(colour, -most, most))
    return blur(np.asarray(ink, dtype=np.float32), _INK_BLUR_PX)


def clip(density: Density, factor: float = 1.0, quantile: float = _CLIP_QUANTILE) -> Density:
    """Return the density without what is darker or brighter than most lines by more than a factor."""
    most = factor * float(np.quantile(np.abs(density[::_CLIP_STRIDE, ::_CLIP_STRIDE]), quantile))
    return np.asarray(np.clip(density, -most, most))


def blur(density: Density, sigma_px: float) -> Density:
    """Return the density smoothed by a Gaussian."""
    return np.asarray(cv2.GaussianBlur(density, (0, 0), sigma_px), dtype=np.float32)


def halve(density: Density, levels: int, least_px: int) -> list[Density]:
    """Return the density and its copies at half the size each; at most so many, none with a side below `least_px`."""
    found = [density]
    while len(found) < levels and min(found[-1].shape) >= 2 * least_px:
        height, width = (extent // 2 for extent in found[-1].shape)
        even = found[-1][: 2 * height, : 2 * width]
        found.append(
            np.asarray(cv2.resize(even, (width, height), interpolation=cv2.INTER_AREA), dtype=np.float32)
        )
    return found


def _density(channel: Picture) -> Density:
    return np.asarray(-np.log(np.maximum(channel.astype(np.float32), 1.0)), dtype=np.float32)


def keep_of_wave(shape: tuple[int, ...], waves_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the share (N,) of waves of these lengths that is left where slow changes of light are removed."""
    return np.asarray(1.0 - np.exp(-2.0 * (np.pi * _slow_sigma_px(shape) / waves_px) ** 2))


def _slow_sigma_px(shape: tuple[int, ...]) -> float:
    return max(min(shape) * _SLOW_SHARE, _LEAST_SLOW_PX)


def _remove_slow_light(density: Density) -> Density:
    """Return the density without uneven light, its slowly varying part."""
    sigma_px = _slow_sigma_px(density.shape)
    height, width = density.shape
    factor = max(int(sigma_px / _COARSE_SIGMA_PX), 1)
    size = -(-width // factor), -(-height // factor)
    small = np.asarray(cv2.resize(density, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
    slow = cv2.resize(blur(small, sigma_px / factor), (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(density - slow, dtype=np.float32)
