"""Design files and protocols that name them."""

import json
from pathlib import Path
from typing import Any

SWEEP = Path(__file__).parents[2] / "protocols" / "steerability.yaml"
NUMBERS = """\
  diameter_mm: 1.2       # outer diameter
  design_radius_mm: 30   # the radius that the hinges were cut for; drawn as a line in the report
"""

DESIGN: dict[str, Any] = {
    "kind": "labrig-needle-design",
    "schema_version": 1,
    "tube": {"outer_diameter_mm": 1.4, "inner_diameter_mm": 0.8, "link_length_mm": 3.5},
    "clearance_mm": 0.03,
    "beta_cut_deg": 2.5,
    "radius_mm": 45.0,
    "radius_low_mm": 42.5,
    "radius_high_mm": 48.0,
    "basis": "our contour",
    "provenance": {"labrig": "0.1.0"},
}


def write_design(path: Path, **changed: object) -> Path:
    """Write a design file, some values changed, and return its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({**DESIGN, **changed}, indent=2), encoding="utf-8")
    return path


def sweep_with(folder: Path, needle: str) -> Path:
    """Write the committed sweep into `folder` with other lines instead of the needle's numbers."""
    text = SWEEP.read_text(encoding="utf-8")
    assert NUMBERS in text
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "sweep.yaml"
    path.write_text(text.replace(NUMBERS, needle), encoding="utf-8")
    return path
