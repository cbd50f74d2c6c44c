"""The needle of table I of the paper."""

from dataclasses import dataclass

from labrig.protocol.design_file import PAPER_TUBE, Tube


@dataclass(frozen=True)
class PaperNeedle:
    """A needle as the paper prints it."""

    tube: Tube
    clearance_mm: float
    radius_mm: float
    beta_cut_deg: float
    beta_rot_deg: float

    def is_asked(self, tube: Tube, clearance_mm: float, radius_mm: float) -> bool:
        """Return whether this is the needle that is asked for."""
        return (tube, clearance_mm, radius_mm) == (self.tube, self.clearance_mm, self.radius_mm)


TABLE_1 = PaperNeedle(PAPER_TUBE, clearance_mm=0.025, radius_mm=30.0, beta_cut_deg=4.13, beta_rot_deg=11.46)
