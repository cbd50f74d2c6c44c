"""Radii of curvature in every picture of a sweep, gel by gel."""

from labrig.experiments.shared.curvature import analyze

__all__ = ["analyze"]
