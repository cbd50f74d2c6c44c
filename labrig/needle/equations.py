"""Equations (1) to (3) of the paper, their inverses, and the tolerance of a radius."""

import math
from dataclasses import dataclass

from labrig.errors import AnswerIsNoError
from labrig.needle.limits import require_within


def radius_mm(beta_rot_deg: float, link_length_mm: float) -> float:
    """Return the steering radius: equation (1), r = 2 H / beta_rot.

    Parameters
    ----------
    beta_rot_deg : float
        Rotation that two adjacent hinges allow together; above 0.
    """
    return 2 * link_length_mm / math.radians(beta_rot_deg)


def rotation_for_radius_deg(radius_mm: float, link_length_mm: float) -> float:
    """Return the rotation that two adjacent hinges have to allow: equation (1) solved for beta_rot.

    Raises
    ------
    InputError
        If two links would have to turn by more than a right angle, or the radius exceeds 10 m.
    """
    require_within(
        "radius",
        radius_mm,
        (4 * link_length_mm / math.pi, 10_000.0),
        "two links turn by no more than a right angle, and by something",
    )
    return math.degrees(2 * link_length_mm / radius_mm)


@dataclass(frozen=True)
class RotationPlane:
    """A plane beta_rot = a beta_cut + b d + c [degrees], the form of equation (3).

    Attributes
    ----------
    a : float
        Degrees for a degree of cutting inclination.
    b : float
        Degrees for a millimetre of laser clearance.
    c : float
        Degrees.
    rmse_deg : float
        Root mean square of the residuals of the searched rotations.
    """

    a: float
    b: float
    c: float
    rmse_deg: float

    def beta_rot_deg(self, beta_cut_deg: float, clearance_mm: float) -> float:
        """Return the rotation of two adjacent hinges."""
        return self.a * beta_cut_deg + self.b * clearance_mm + self.c

    def beta_cut_deg(self, beta_rot_deg: float, clearance_mm: float) -> float:
        """Return the inclination to cut.

        Raises
        ------
        AnswerIsNoError
            If the clearance alone lets the hinges turn further.
        """
        beta_cut_deg = (beta_rot_deg - self.b * clearance_mm - self.c) / self.a
        if beta_cut_deg < 0:
            raise AnswerIsNoError(
                f"no inclination gives {beta_rot_deg:.4g} degrees: a clearance of {clearance_mm:g} mm alone allows "
                f"{self.beta_rot_deg(0.0, clearance_mm):.4g}",
                "ask for a smaller radius, or cut with a smaller clearance",
            )
        return beta_cut_deg

    def clearance_mm(self, beta_rot_deg: float, beta_cut_deg: float) -> float:
        """Return the clearance that explains a rotation: the effective clearance of a measured needle.

        Raises
        ------
        AnswerIsNoError
            If the inclination alone lets the hinges turn further.
        """
        clearance_mm = (beta_rot_deg - self.a * beta_cut_deg - self.c) / self.b
        if clearance_mm < 0:
            raise AnswerIsNoError(
                f"no clearance gives {beta_rot_deg:.4g} degrees: an inclination of {beta_cut_deg:.4g} degrees alone "
                f"allows {self.beta_rot_deg(beta_cut_deg, 0.0):.4g}",
                "the hinges did not reach their stops, or they were cut at a smaller inclination",
            )
        return clearance_mm


EQUATION_3 = RotationPlane(a=1.09, b=296.0, c=-0.433, rmse_deg=0.1608)
FIT_SD = 2.0  # a rotation may be off its plane by so many rms residuals


@dataclass(frozen=True)
class RadiusTolerance:
    """The sensitivity of a radius to clearance and inclination, and its worst cases.

    Attributes
    ----------
    per_clearance : float
        Slope, mm of radius for a mm of clearance; negative.
    per_degree_mm : float
        Slope, mm of radius for a degree of inclination; negative.
    low_mm, high_mm : float
        The radius if both tolerances and the fit's error add up; `high_mm` is None if the hinges might not turn at all.
    """

    per_clearance: float
    per_degree_mm: float
    low_mm: float
    high_mm: float | None


def radius_tolerance(
    plane: RotationPlane,
    beta_rot_deg: float,
    link_length_mm: float,
    *,
    clearance_tolerance_mm: float,
    cut_tolerance_deg: float,
) -> RadiusTolerance:
    """Return the slopes of the radius at a rotation, and its worst cases.

    With r = 2 H / beta_rot a slope is -r / beta_rot times that of the plane. In the worst cases both tolerances are at
    their limit to one side, and the rotation is off the plane by `FIT_SD` of its rms residuals.
    """
    slope = -radius_mm(beta_rot_deg, link_length_mm) / beta_rot_deg
    spread_deg = plane.b * clearance_tolerance_mm + plane.a * cut_tolerance_deg + FIT_SD * plane.rmse_deg
    least_deg = beta_rot_deg - spread_deg
    return RadiusTolerance(
        per_clearance=slope * plane.b,
        per_degree_mm=slope * plane.a,
        low_mm=radius_mm(beta_rot_deg + spread_deg, link_length_mm),
        high_mm=radius_mm(least_deg, link_length_mm) if least_deg > 0 else None,
    )
