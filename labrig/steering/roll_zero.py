"""The roll zero of a needle: the roll that bends it towards -y, from its deflection at several rolls."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labrig.errors import InputError, MeasurementRefusedError
from labrig.vision.out_of_plane import Perspective

FloatArray = NDArray[np.float64]

# Four cannot tell a cosine from its third harmonic, which the look of the bevel adds to the reading of its end: in
# simulated insertions it turned the zero by up to 1.3 degrees, where 0.2 was told.
_LEAST_INSERTIONS = 5
_MOST_OFF = 0.25
# Each leaves a hundredth of what the round before it left.
_ROUNDS = 3


@dataclass(frozen=True)
class RollZeroFit:
    """The roll at which the needle bends towards -y, and its uncertainty.

    Attributes
    ----------
    zero_rad, sd_rad : float
        Position of the rotation axis, between -pi and pi, and its standard deviation.
    bend_mm, expected_mm : float
        Deflection of the tip at the zero, and that of an arc of the design radius.
    residual_rms_mm : float
        Of the deflections about the fitted cosine.
    """

    zero_rad: float
    sd_rad: float
    bend_mm: float
    expected_mm: float
    residual_rms_mm: float


def correct_perspective(
    roll_rad: ArrayLike, seen_mm: ArrayLike, perspective: Perspective | None
) -> list[float]:
    """Return the deflections (N,) of tips without what the camera's place does to them [mm].

    A tip out of the plane is seen shifted along its line of sight. How far out it is follows from the cosine, so that
    both are found in turns. Without a perspective the deflections are returned as they were seen.
    """
    seen, terms = np.asarray(seen_mm, dtype=float), _list_terms(roll_rad)
    slopes = 0.0 if perspective is None else (seen - perspective.foot_mm[0]) / perspective.height_mm
    deflections = seen
    for _ in range(_ROUNDS):
        _, cosine, sine = np.linalg.lstsq(terms, deflections, rcond=None)[0]
        deflections = seen + slopes * (terms[:, 1] * sine - terms[:, 2] * cosine)
    return list(map(float, deflections))


def _list_terms(roll_rad: ArrayLike) -> FloatArray:
    rolls = np.asarray(roll_rad, dtype=float)
    return np.column_stack((np.ones_like(rolls), np.cos(rolls), np.sin(rolls)))


def fit_roll_zero(
    roll_rad: ArrayLike, deflection_mm: ArrayLike, length_mm: float, radius_mm: float
) -> RollZeroFit:
    """Return the roll zero from insertions of one length at several positions of the rotation axis.

    By equation (5) the tip's deflection is y = -r (1 - cos(l / r)) cos(delta - delta_0). With a constant for the
    sheath's position that is linear in (1, cos delta, sin delta); least squares, first-order propagation.

    Parameters
    ----------
    roll_rad : (N,) array
        Positions of the rotation axis, five or more, spread over a turn.
    deflection_mm : (N,) array
        y of the tip.
    length_mm, radius_mm : float
        Inserted beyond the sheath, and the expected radius.

    Raises
    ------
    InputError
        For fewer insertions.
    MeasurementRefusedError
        If the bend is not as expected, or its side is undetermined.
    """
    rolls, places = np.asarray(roll_rad, dtype=float), np.asarray(deflection_mm, dtype=float)
    if len(rolls) != len(places) or len(rolls) < _LEAST_INSERTIONS:
        raise InputError(
            f"{len(rolls)} rolls and {len(places)} deflections, five of each are the least",
            "insert more often",
        )
    terms = _list_terms(rolls)
    solution, _, rank, _ = np.linalg.lstsq(terms, places, rcond=None)
    expected_mm = radius_mm * (1.0 - math.cos(length_mm / radius_mm))
    bend_mm = math.hypot(solution[1], solution[2])
    if rank < terms.shape[1] or abs(bend_mm - expected_mm) > _MOST_OFF * expected_mm:
        raise MeasurementRefusedError(
            f"no roll zero: over {length_mm:g} mm the needle bends by {bend_mm:.2f} mm; with a radius of "
            f"{radius_mm:g} mm it would be {expected_mm:.2f} mm, and {100 * _MOST_OFF:g} % off is the most",
            "check needle and gel; the radius is planner: radius_mm: of an insertion, else needle: design_radius_mm:",
        )
    residuals = places - terms @ solution
    spread_mm = math.sqrt(float(residuals @ residuals) / (len(rolls) - terms.shape[1]))
    covariance = spread_mm**2 * np.linalg.inv(terms.T @ terms)[1:, 1:]
    zero_rad = math.atan2(-solution[2], -solution[1])
    across = np.array((-math.sin(zero_rad), math.cos(zero_rad)))
    return RollZeroFit(
        zero_rad=zero_rad,
        sd_rad=math.sqrt(float(across @ covariance @ across)) / bend_mm,
        bend_mm=bend_mm,
        expected_mm=expected_mm,
        residual_rms_mm=math.sqrt(float(np.mean(residuals**2))),
    )
