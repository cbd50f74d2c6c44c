"""What `labrig calibrate intrinsics` makes of its options, and the picture that it writes beside the file."""

from pathlib import Path

from labrig.errors import DiskError, InputError
from labrig.report import write_lens_figure
from labrig.vision import BoardSearch, Charuco, Intrinsics


def board_search(
    charuco: str | None, marker_mm: float | None, square_mm: float, partial: bool, window_px: int | None
) -> BoardSearch:
    """Return how the board is looked for.

    Raises
    ------
    InputError
        If only one of dictionary and marker is given, or the window is impossible.
    """
    if (charuco is None) != (marker_mm is None):
        raise InputError(
            "--charuco and --marker-mm belong together", "for example --charuco DICT_5X5_100 --marker-mm 12"
        )
    board = None if charuco is None or marker_mm is None else Charuco(charuco, marker_mm / square_mm)
    return BoardSearch(partial, board, window_px)


def picture_beside(out: Path | None) -> Path | None:
    """Return the picture of residuals and coverage that stands beside a calibration file."""
    return None if out is None else out.with_suffix(".png")


def draw_beside(out: Path, lens: Intrinsics) -> None:
    """Draw residuals and coverage beside the calibration file.

    Raises
    ------
    DiskError
        If the picture cannot be written.
    """
    picture = out.with_suffix(".png")
    try:
        write_lens_figure(picture, lens)
    except OSError as error:
        raise DiskError(
            f"{picture} cannot be written: {error.strerror}", "check the folder and its space"
        ) from error
