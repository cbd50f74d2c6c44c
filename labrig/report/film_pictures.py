"""What a film shows: recorded pictures by their numbers, with lines over them; loads nothing that draws."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Colour = tuple[int, int, int]
"""(red, green, blue), 0 to 255."""


@dataclass(frozen=True, eq=False)
class Stroke:
    """A line over a picture: its pixels (N, 2), its colour and width, and what it is, for the key; empty for no key."""

    px: NDArray[np.float64]
    colour: Colour
    width_px: int = 2
    name: str = ""


@dataclass(frozen=True, eq=False)
class FilmPicture:
    """A recorded picture by its number, the lines over it, and a caption in ASCII."""

    frame: int
    strokes: tuple[Stroke, ...]
    caption: str


@dataclass(frozen=True, eq=False)
class Film:
    """The pictures of a film in order, and the name of its file without suffix."""

    name: str
    pictures: Sequence[FilmPicture]
