"""The paper's results, for comparison with our measurements.

Y. Chen, H. Yang, X. Liu and K. Xu, "Design and kinematic modeling of a novel steerable needle for
image-guided insertion", section V-B and figure 8: eighteen insertions of 40 mm into each gel.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class PaperGel:
    """Radius of curvature in one gel: gelatin powder to water [mass %], mean and standard deviation [mm]."""

    gelatin_percent: float
    mean_radius_mm: float
    sd_radius_mm: float
    n: int = 18


PAPER_GELS = (
    PaperGel(10.0, 28.34, 0.247),
    PaperGel(13.0, 27.71, 0.237),
    PaperGel(16.0, 27.36, 0.459),
    PaperGel(19.0, 27.13, 0.473),
)
# Rounded in the paper; the mean of the four means is 27.635 mm.
PAPER_MEAN_RADIUS_MM = 27.6
