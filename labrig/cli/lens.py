"""Options of `labrig calibrate` as values, and the picture that it writes beside the calibration file."""

from collections.abc import Sequence
from pathlib import Path

from labrig.errors import InputError, PictureError
from labrig.report.lens_figure import write_lens_figure
from labrig.vision.boards import AprilGrid, BoardSearch, Charuco
from labrig.vision.intrinsics import Intrinsics, ViewResidual
from labrig.vision.picture import Picture, read_picture


def make_board_search(
    charuco: str | None,
    marker_mm: float | None,
    square_mm: float,
    partial: bool,
    window_px: int | None,
    tag_spacing: float | None = None,
) -> BoardSearch:
    """Return how to search for the board.

    Raises
    ------
    InputError
        If only one of dictionary and marker is given, if they are given with a tag spacing, or if the window or the tag
        spacing is impossible.
    """
    if (charuco is None) != (marker_mm is None):
        raise InputError(
            "--charuco and --marker-mm belong together", "for example --charuco DICT_5X5_100 --marker-mm 12"
        )
    board = None if charuco is None or marker_mm is None else Charuco(charuco, marker_mm / square_mm)
    grid = None if tag_spacing is None else AprilGrid(tag_spacing)
    return BoardSearch(partial, board, window_px, grid)


def read_views(images: Sequence[Path]) -> tuple[list[tuple[str, Picture]], list[ViewResidual]]:
    """Return the pictures that can be read, by name, and why the others cannot.

    Raises
    ------
    InputError
        If none can be read.
    """
    pictures: list[tuple[str, Picture]] = []
    refused: list[tuple[str, PictureError]] = []
    for path in images:
        try:
            pictures.append((path.name, read_picture(path)))
        except PictureError as error:
            refused.append((path.name, error))
    if not pictures:
        first = refused[0][1]
        raise InputError(f"none of the {len(images)} pictures can be read: {first.message}", first.hint)
    unread = [
        ViewResidual(name, None, used=False, reason=f"{why.message}: {why.hint}") for name, why in refused
    ]
    return pictures, unread


def name_figure(out: Path | None) -> Path | None:
    """Return the file of the picture of residuals and coverage beside a calibration file. Raises `InputError`."""
    if out is not None and out.suffix == ".png":
        raise InputError(
            f"{out} is the name of the picture that is drawn beside the calibration", "name it .json"
        )
    return None if out is None else out.with_suffix(".png")


def draw_figure(out: Path, lens: Intrinsics) -> None:
    """Draw residuals and coverage into a picture beside the calibration file.

    Raises
    ------
    DiskError
        If the picture cannot be written.
    """
    write_lens_figure(out.with_suffix(".png"), lens)
