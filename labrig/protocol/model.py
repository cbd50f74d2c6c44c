"""The base of every model that a YAML file fills, and the types of its fields.

A model is frozen, refuses unknown keys, takes no text for a number and no NaN or infinity. The docstring below each
field describes it, with its unit in brackets; the schema, the editor and the error messages show it.
"""

import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Literal, Self, TypeAlias

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

PositiveMm: TypeAlias = Annotated[float, Field(gt=0, le=1000)]
NonNegativeMm: TypeAlias = Annotated[float, Field(ge=0, le=1000)]
SpeedMmS: TypeAlias = Annotated[float, Field(gt=0, le=100)]
LimitMa: TypeAlias = Annotated[int, Field(ge=1, le=100_000)]
Seed: TypeAlias = Annotated[int, Field(ge=0, le=2**32 - 1)]
PixelUv: TypeAlias = tuple[float, float]
Coordinate: TypeAlias = Annotated[float, Field(ge=-10_000, le=10_000)]
PointMm: TypeAlias = tuple[Coordinate, Coordinate, Coordinate]
Direction: TypeAlias = Literal["right", "left", "up", "down"]
MarkerId: TypeAlias = Annotated[int, Field(ge=0, le=10_000)]
MarkerDictionary: TypeAlias = Literal[
    "DICT_4X4_50", "DICT_4X4_100", "DICT_4X4_250", "DICT_4X4_1000",
    "DICT_5X5_50", "DICT_5X5_100", "DICT_5X5_250", "DICT_5X5_1000",
    "DICT_6X6_50", "DICT_6X6_100", "DICT_6X6_250", "DICT_6X6_1000",
    "DICT_7X7_50", "DICT_7X7_100", "DICT_7X7_250", "DICT_7X7_1000",
    "DICT_ARUCO_ORIGINAL", "DICT_ARUCO_MIP_36h12",
    "DICT_APRILTAG_16h5", "DICT_APRILTAG_25h9", "DICT_APRILTAG_36h10", "DICT_APRILTAG_36h11",
]  # fmt: skip
"""OpenCV's names of dictionaries of markers."""

# Joiners that scripts and emoji need; any other invisible character could make two names look the same.
_ALLOWED_INVISIBLE = "\u200c\u200d"
_REFUSED_CATEGORIES = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})


@dataclass(frozen=True)
class Conflict:
    """Two values that are right alone and wrong together.

    Parameters
    ----------
    key : str
        The dotted key to change, relative to the model that yields the conflict.
    message : str
        Names the value, its limit and the other key that sets the limit.
    hint : str
        What to do.
    """

    key: str
    message: str
    hint: str = ""


class ConflictError(ValueError):
    """Carries the conflicts of a model through pydantic; `load_yaml_model` turns it into problems."""

    def __init__(self, conflicts: tuple[Conflict, ...]) -> None:
        super().__init__("; ".join(conflict.message for conflict in conflicts))
        self.conflicts = conflicts


class Model(BaseModel):
    """Base of protocols, rig files and their sections.

    A subclass that has rules across fields overrides `conflicts`; all conflicts are reported, each at its key.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, use_attribute_docstrings=True
    )

    def conflicts(self) -> Iterable[Conflict]:
        """Yield what is wrong between fields; called only if each field is valid alone."""
        return ()

    @model_validator(mode="after")
    def _refuse_conflicts(self) -> Self:
        if found := tuple(self.conflicts()):
            raise ConflictError(found)
        return self


def _require_visible(text: str, *, also: str = "") -> str:
    for position, character in enumerate(text, start=1):
        allowed = character in also or character in _ALLOWED_INVISIBLE
        if not allowed and unicodedata.category(character) in _REFUSED_CATEGORIES:
            raise ValueError(
                f"the invisible character U+{ord(character):04X} at position {position} is not allowed"
            )
    return text


def _require_name(text: str) -> str:
    if text != text.strip():
        raise ValueError("a name neither starts nor ends with a space")
    return _require_visible(text)


def _require_rising(ends: tuple[float, float]) -> tuple[float, float]:
    if ends[0] >= ends[1]:
        raise ValueError(f"[{ends[0]:g}, {ends[1]:g}] must have the lower one first")
    return ends


Interval: TypeAlias = Annotated[tuple[float, float], AfterValidator(_require_rising)]
"""A lowest and a highest value."""

Name: TypeAlias = Annotated[str, Field(min_length=1, max_length=64), AfterValidator(_require_name)]
"""Any printable text that names a thing; two names are equal only if all their characters are."""

Line: TypeAlias = Annotated[str, Field(max_length=200), AfterValidator(_require_visible)]
"""Any printable text on one line; it may be empty."""

_Lines = AfterValidator(partial(_require_visible, also="\n\t"))
Notes: TypeAlias = Annotated[str, Field(max_length=10_000), _Lines]
"""Any printable text, also of several lines; it may be empty."""
