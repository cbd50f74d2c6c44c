"""The tube from which a needle's tip is cut, and the needle of table I."""

from dataclasses import dataclass

from labrig.errors import InputError
from labrig.needle.limits import require_within


@dataclass(frozen=True)
class Tube:
    """A tube cut into links: outer and inner diameter (D_o, D_i), and the length of a link from pin to pin (H).

    Raises
    ------
    InputError
        If a length is implausible for a needle, or the inner diameter is not below the outer diameter.
    """

    outer_diameter_mm: float = 1.2
    inner_diameter_mm: float = 0.7
    link_length_mm: float = 3.0

    def __post_init__(self) -> None:
        require_within(
            "outer diameter", self.outer_diameter_mm, (0.2, 10.0), "needles are no thinner and no thicker"
        )
        require_within("inner diameter", self.inner_diameter_mm, (0.1, 9.9), "needles have no such bore")
        require_within("link length", self.link_length_mm, (0.2, 100.0), "needle tips have no such links")
        if self.inner_diameter_mm >= self.outer_diameter_mm:
            raise InputError(
                f"inner diameter is {self.inner_diameter_mm:g} mm, "
                f"and has to be below the outer diameter, {self.outer_diameter_mm:g} mm",
                "the two may have been given the wrong way round",
            )


@dataclass(frozen=True)
class PaperNeedle:
    """The needle of table I of the paper."""

    tube: Tube
    clearance_mm: float
    radius_mm: float
    beta_cut_deg: float
    beta_rot_deg: float


TABLE_1 = PaperNeedle(Tube(), clearance_mm=0.025, radius_mm=30.0, beta_cut_deg=4.13, beta_rot_deg=11.46)
