"""Whether the lines have a second ink: finer lines printed in one colour under lines drawn in another.

Lines of one ink have the same profile in every channel. The sharpness of a channel changes its harmonics with the
square of their number, which the comparison of a harmonic with those beside it leaves out (`lines_between`). What this
comparison still finds different between channels is ink of another colour between the lines. Where blur leaves only two
harmonics, their ratio alone is compared. Channels that agree prove nothing: pen and print can have one colour.
"""

import numpy as np

from labrig.errors import MeasurementRefusedError
from labrig.vision.grid_tracking import TrackedGrid
from labrig.vision.line_density import clip, measure_channels
from labrig.vision.line_profile import Comb, Harmonics, measure_profile
from labrig.vision.lines_between import average, compare_harmonics
from labrig.vision.picture import Picture
from labrig.vision.ruling import Ruling

# Harmonics that are compared, with the least difference between channels: print of one ink has 0.09 and 0.25; in
# standard errors; and the shortest wave and the longest distance between lines [px] at which it is looked for.
_LEAST_DIFFERENCE = {2: 0.12, 3: 0.3, 4: 0.3}
_PAIR, _LEAST_PAIR_DIFFERENCE = 2, 0.25
_LEAST_SIGMAS, _LEAST_WAVE_PX, _MOST_SPACING_PX = 4.0, 1.5, 13.0


def require_one_ink(image: Picture, grid: TrackedGrid, ruling: Ruling, most: float) -> None:
    """Refuse lines between which there is ink of another colour.

    Parameters
    ----------
    most : float
        What is darker than most lines by more than this factor is clipped, as for the ruling.

    Raises
    ------
    MeasurementRefusedError
    """
    spacing_px = grid.pitch_px * min(ruling.steps)
    if image.ndim == 2 or ruling.hidden > 1 or spacing_px > _MOST_SPACING_PX:
        return
    combs = [Comb(step, offset) for step, offset in zip(ruling.steps, ruling.offsets, strict=True)]
    channels = []
    for channel in measure_channels(image):
        bare = clip(channel, most)
        channels.append(
            [Harmonics.of(measure_profile(bare, grid, axis), comb) for axis, comb in enumerate(combs)]
        )
    different = any(
        _differ([compare_harmonics(families, number) for families in channels], least)
        for number, least in _LEAST_DIFFERENCE.items()
        if spacing_px / (number + 1) >= _LEAST_WAVE_PX
    )
    if not different and _PAIR in ruling.undecided:
        different = _differ([_average_ratio(families) for families in channels], _LEAST_PAIR_DIFFERENCE)
    if different:
        raise MeasurementRefusedError(
            f"between the lines {spacing_px:.1f} px apart there is ink of another colour: finer lines that cannot be "
            "seen one by one, or another pattern",
            "show graph paper on which nothing else is ruled, or come closer with the camera",
        )


def _average_ratio(families: list[Harmonics]) -> tuple[float, float] | None:
    """Return the logarithm of the second harmonic over the first, and its variance; None if it is lost in noise."""
    found = []
    for family in families:
        first, second = family.at((1.0, 2.0)).real
        noise = family.noise(2)
        if min(first, second) < _LEAST_SIGMAS * noise:
            return None
        found.append((float(np.log(second / first)), float(noise / second)))
    return average(found)


def _differ(channels: list[tuple[float, float] | None], least: float) -> bool:
    """Return whether the values of two channels, with their variances, differ."""
    known = [channel for channel in channels if channel is not None]
    return any(
        first[0] - second[0] > max(least, _LEAST_SIGMAS * (first[1] + second[1]) ** 0.5)
        for first in known
        for second in known
    )
