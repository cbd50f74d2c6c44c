"""Radii of curvature in imported pictures."""

from labrig.errors import Problem
from labrig.experiments.imported_pictures.protocol import ImportProtocol
from labrig.experiments.shared.curvature import analyze

__all__ = ["analyze", "find_problems"]


def find_problems(_protocol: ImportProtocol) -> tuple[Problem, ...]:
    """Return why this protocol cannot be run: its pictures are recorded already."""
    hint = "use labrig import, then labrig reanalyze"
    return (Problem("experiment", "a protocol of imported pictures moves no rig", hint),)
