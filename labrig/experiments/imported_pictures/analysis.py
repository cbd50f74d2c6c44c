"""Radii of curvature in imported pictures."""

from labrig.experiments.shared.curvature import analyze

__all__ = ["analyze"]
