"""The paper's results, for comparison with our measurements.

Y. Chen, H. Yang, X. Liu and K. Xu, "Design and kinematic modeling of a novel steerable needle for
image-guided insertion", section V-B and figure 8: eighteen insertions of 40 mm into each gel.
"""

from collections.abc import Mapping

PAPER_GELS: Mapping[float, tuple[float, float]] = {
    10.0: (28.34, 0.247),
    13.0: (27.71, 0.237),
    16.0: (27.36, 0.459),
    19.0: (27.13, 0.473),
}
"""Gelatin powder to water [mass %] -> mean and standard deviation of the radius of curvature [mm]."""
