"""Does the same for each picture of a command line; one that cannot be used does not stop the others."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from labrig.errors import InputError, PictureError

_T = TypeVar("_T")


def use_each(
    images: Sequence[Path], use: Callable[[Path], _T], refuse: Callable[[Path, PictureError], _T]
) -> list[_T]:
    """Return what is made of each picture, or of its refusal.

    Raises
    ------
    InputError
        When no picture can be used.
    """
    made: list[_T] = []
    refusals: list[PictureError] = []
    for path in images:
        try:
            made.append(use(path))
        except PictureError as error:
            made.append(refuse(path, error))
            refusals.append(error)
    if len(refusals) == len(images):
        raise InputError(f"no picture can be used: {refusals[0].message}", refusals[0].hint)
    return made
