"""A design on disk, as JSON: what was cut, for which radius within which tolerance, and how that was computed."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from labrig.errors import FileFormatError, Problem
from labrig.needle.tube import Tube

DESIGN_KIND = "labrig-needle-design"
_SCHEMA_VERSION = 1
_MAX_BYTES = 256 * 1024
_AGAIN = "write it again with `labrig design --out`"

Basis = Literal["equation (3)", "our contour"]


@dataclass(frozen=True)
class NeedleDesign:
    """What other rooms need of a design.

    Attributes
    ----------
    tube : Tube
        What it is cut from.
    clearance_mm, beta_cut_deg : float
        How it is cut.
    radius_mm : float
        Steering radius that it is cut for.
    radius_low_mm, radius_high_mm : float
        Worst cases of the radius within the laser's tolerances; low <= radius <= high.
    basis : str
        By which plane `beta_cut_deg` and the tolerance were computed.
    """

    tube: Tube
    clearance_mm: float
    beta_cut_deg: float
    radius_mm: float
    radius_low_mm: float
    radius_high_mm: float
    basis: Basis

    @property
    def diameter_mm(self) -> float:
        """Outer diameter of the needle."""
        return self.tube.outer_diameter_mm

    def to_json(self, provenance: Mapping[str, Any]) -> dict[str, Any]:
        """Return the document of a design file; `provenance` holds JSON values."""
        return {
            "kind": DESIGN_KIND,
            "schema_version": _SCHEMA_VERSION,
            "tube": dict(vars(self.tube)),
            "clearance_mm": self.clearance_mm,
            "beta_cut_deg": self.beta_cut_deg,
            "radius_mm": self.radius_mm,
            "radius_low_mm": self.radius_low_mm,
            "radius_high_mm": self.radius_high_mm,
            "basis": self.basis,
            "provenance": dict(provenance),
        }


class _Part(BaseModel):
    """What a file must hold; more may stand beside it."""

    model_config = ConfigDict(frozen=True, extra="ignore", strict=True, allow_inf_nan=False)


class _TubeDocument(_Part):
    outer_diameter_mm: float
    inner_diameter_mm: float
    link_length_mm: float


class _Document(_Part):
    kind: Literal["labrig-needle-design"]
    schema_version: Literal[1]
    tube: _TubeDocument
    clearance_mm: float
    beta_cut_deg: float
    radius_mm: float
    radius_low_mm: float
    radius_high_mm: float
    basis: Basis

    def design(self) -> NeedleDesign:
        values = self.model_dump(exclude={"kind", "schema_version", "tube"})
        return NeedleDesign(tube=Tube(**self.tube.model_dump()), **values)


def load_design(path: Path) -> NeedleDesign:
    """Read a design that `labrig design --out` or a design run wrote.

    Raises
    ------
    FileFormatError
        When the file is missing, not JSON, of another kind, newer than this program, lacks a value, or says what
        no design can.
    InputError
        When its tube is none.
    """
    text = _read_text(path)
    try:
        found = _Document.model_validate_json(text)
    except ValidationError as error:
        raise FileFormatError(tuple(_problem(path, text, fault) for fault in error.errors())) from error
    design = found.design()
    _require_interval(path, design)
    return design


def _require_interval(path: Path, design: NeedleDesign) -> None:
    low_mm, high_mm = design.radius_low_mm, design.radius_high_mm
    if not 0 < low_mm <= design.radius_mm <= high_mm:
        message = (
            f"{design.radius_mm:g} mm, and has to lie within its tolerance, {low_mm:g} to {high_mm:g} mm"
        )
        raise FileFormatError((Problem(f"{path} radius_mm", message, _AGAIN),))


def _read_text(path: Path) -> str:
    try:
        with path.open("rb") as file:
            content = file.read(_MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = getattr(error, "strerror", None) or str(error)
        problem = Problem(str(path), f"cannot be read: {reason}", "make it with `labrig design --out`")
        raise FileFormatError((problem,)) from error
    if len(content) > _MAX_BYTES:
        raise FileFormatError((Problem(str(path), f"larger than {_MAX_BYTES // 1024} kB", _AGAIN),))
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise FileFormatError((Problem(str(path), "is not UTF-8, so no design", _AGAIN),)) from error


def _problem(path: Path, text: str, fault: Mapping[str, Any]) -> Problem:
    """Return what pydantic found as a problem; a kind or version of another file is said as such."""
    place = ".".join(map(str, fault["loc"]))
    if fault["type"] == "json_invalid":
        return Problem(str(path), f"is not JSON: {fault['msg'].removeprefix('Invalid JSON: ')}", _AGAIN)
    if place in {"kind", "schema_version"}:
        found = json.loads(text).get(place)
        wanted = DESIGN_KIND if place == "kind" else f"{_SCHEMA_VERSION}; a newer file needs a newer labrig"
        return Problem(f"{path} {place}", f"{place} is {found!r}, expected {wanted}", _AGAIN)
    return Problem(f"{path} {place}".rstrip(), fault["msg"], _AGAIN)
