"""Specimen files, and the committed sweep in the blocks that they describe."""

from pathlib import Path

from labrig.lab import SPECIMENS
from labrig.protocol.specimen_file import SpecimenSection, SpecimenTrack
from tests.protocol.designs import SWEEP

CAST_ON = "2026-11-20T09:30+01:00"


def write_specimen(root: Path, name: str = "A1", lines: str = "") -> Path:
    """Write a specimen file of 10 % gelatin below a root folder, some lines added."""
    path = root / SPECIMENS / f"{name}.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"name: {name}\ngelatin_percent: 10\ncast_on: {CAST_ON}\n{lines}", encoding="utf-8")
    return path


def sweep_in(root: Path, gel: str) -> Path:
    """Write the committed sweep into `root`/protocols with one gel, given by its line."""
    text = SWEEP.read_text(encoding="utf-8")
    begin, end = text.index("specimens:\n"), text.index("# Eighteen insertions per block")
    path = root / "protocols" / "sweep.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"{text[:begin]}specimens:\n  - {gel}\n\n{text[end:]}", encoding="utf-8")
    return path


def make_track(place_mm: float = 0.0, **changed: object) -> SpecimenTrack:
    """Return a track of a sheath of 2 mm."""
    values: dict[str, object] = {
        "run": "earlier", "trial": 0, "hole": 0, "hole_position_mm": place_mm, "needle_id": "N1",
        "sheath_diameter_mm": 2.0, "age_h": 24.0,
    }  # fmt: skip
    return SpecimenTrack.model_validate({**values, **changed})


def make_section(*tracks: SpecimenTrack) -> SpecimenSection:
    """Return the section of a specimen with these tracks in it."""
    return SpecimenSection(name="A1", gelatin_percent=10.0, cast_on=CAST_ON, sha256="0" * 64, tracks=tracks)
