"""The result of measured pictures, which sweeps and imported pictures share."""

from labrig.experiments.shared.curvature_result import CurvatureResult as RunResult
from labrig.experiments.shared.curvature_result import summarise

__all__ = ["RunResult", "summarise"]
