"""What the standard deviation of a measured length or place consists of, source by source.

The sources are independent, so their squares add up. A source that is None is not known; it is then **not in the
interval**, and whoever reads the number must be told so.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labrig.protocol.model import Model
from labrig.vision.plane import PlaneMap, VariationGroup

FloatArray = NDArray[np.float64]

# Standard deviation of the shift of the centre line in even light [px]: twice the 0.005 px rms that
# `python -m tests.benchmarks coverage` shows there.
LEAST_LIGHT_SHIFT_PX = 0.01


class ErrorBudget(Model):
    """Standard deviations [mm] of a length, or of a place (the root of the sum over both coordinates).

    Attributes
    ----------
    lens : float or None
        Of the lens's calibration.
    plane : float or None
        Of the map of the plane: the paper's crossings and its bend.
    surface : float or None
        Of the gel's surface and the walls before the needle.
    roll : float or None
        Of the angle between the plane in which the needle bends and the plane of the map.
    lighting : float or None
        Of the shift of the centre line by uneven light.
    fit : float or None
        Of the scatter of the edges.
    """

    lens: float | None = None
    plane: float | None = None
    surface: float | None = None
    roll: float | None = None
    lighting: float | None = None
    fit: float | None = None

    @property
    def total(self) -> float:
        """The standard deviation [mm] by all known sources."""
        return float(np.linalg.norm([sigma for sigma in vars(self).values() if sigma is not None]))

    @property
    def calibration(self) -> float:
        """The standard deviation [mm] by lens, plane and surface, as far as they are known."""
        return ErrorBudget(lens=self.lens, plane=self.plane, surface=self.surface).total

    @property
    def missing(self) -> tuple[str, ...]:
        """The sources that are not known, and not in the interval."""
        return tuple(source for source, sigma in vars(self).items() if sigma is None)

    @property
    def largest(self) -> str | None:
        """The known source with the largest part; None if none is known."""
        known = {source: sigma for source, sigma in vars(self).items() if sigma is not None}
        return max(known, key=lambda source: known[source], default=None)

    def with_drift(self, drift_mm: float) -> Self:
        """Return the budget with a drift of the camera since the calibration, as a part of the plane's."""
        drifted = {"plane": float(np.hypot(self.plane or 0.0, drift_mm))}
        return self.model_copy(update=drifted) if drift_mm else self


def propagate_map(
    plane: PlaneMap, px: ArrayLike, change: Callable[[FloatArray], ArrayLike]
) -> dict[VariationGroup, float | None]:
    """Return the standard deviation [mm] of a quantity by each group of the map's variations; None for an empty group.

    Parameters
    ----------
    plane : PlaneMap
    px : (N, 2) array
        The pixels that the quantity rests on.
    change : callable
        Returns the change of the quantity, a number or a vector, if the pixels show these places (N, 2) instead.
    """
    return {
        group: float(np.linalg.norm(np.array([change(places) for places in moved]))) if moved else None
        for group, moved in plane.map_by_variants(px).items()
    }


@dataclass(frozen=True, eq=False)
class PlaceErrors:
    """The errors of a place in the plane that are not of the map; unknown ones are None.

    Attributes
    ----------
    light_shift_mm : ndarray (2,) or None
        By how much uneven light may have shifted it.
    roll_shift_mm : ndarray (2,) or None
        By how much a standard deviation of the roll shifts it.
    fit_mm : float or None
        Standard deviation of its reading.
    """

    light_shift_mm: FloatArray | None = None
    roll_shift_mm: FloatArray | None = None
    fit_mm: float | None = None


def budget_place(
    plane: PlaneMap, px: ArrayLike, errors: PlaceErrors, towards: FloatArray | None = None
) -> ErrorBudget:
    """Return the error budget of the place that a pixel (u, v) shows.

    With `towards`, a unit vector (y, z), it is that of the distance in this direction.
    """
    pixel = np.asarray(px, dtype=np.float64)[None]
    here = plane.to_mm(pixel)[0]

    def measure(shift: FloatArray | None) -> float | None:
        if shift is None:
            return None
        return float(np.linalg.norm(shift)) if towards is None else abs(float(shift @ towards))

    light = measure(errors.light_shift_mm)
    floor_mm = LEAST_LIGHT_SHIFT_PX * plane.mm_per_px
    return ErrorBudget(
        **propagate_map(plane, pixel, lambda places: measure(places[0] - here) or 0.0),
        roll=measure(errors.roll_shift_mm),
        lighting=None if light is None else float(np.hypot(light, floor_mm)),
        fit=errors.fit_mm,
    )
