"""The options of `labrig calibrate` for boards."""

from pathlib import Path

import pytest

from labrig.cli.lens import draw_figure, make_board_search, name_figure
from labrig.errors import DiskError, InputError
from labrig.vision.boards import AprilGrid, BoardSearch, Charuco
from labrig.vision.intrinsics import Intrinsics


def test_charuco_board_is_described_by_dictionary_and_marker() -> None:
    """The marker is stored as a fraction of the square; a chessboard has neither."""
    found = make_board_search("DICT_5X5_100", 12.0, 16.0, partial=False, window_px=None)
    assert found == BoardSearch(charuco=Charuco("DICT_5X5_100", 0.75))
    assert make_board_search(None, None, 16.0, partial=True, window_px=4) == BoardSearch(True, None, 4)


def test_tag_spacing_makes_the_board_an_aprilgrid() -> None:
    """The spacing describes the grid; together with a dictionary of a ChArUco board it is wrong input."""
    found = make_board_search(None, None, 88.0, partial=False, window_px=None, tag_spacing=0.3)
    assert found == BoardSearch(april=AprilGrid(0.3))
    with pytest.raises(InputError, match="not both"):
        make_board_search("DICT_5X5_100", 12.0, 16.0, partial=False, window_px=None, tag_spacing=0.3)
    with pytest.raises(InputError, match=r"tag spacing is 1\.5"):
        make_board_search(None, None, 88.0, partial=False, window_px=None, tag_spacing=1.5)


@pytest.mark.parametrize(("charuco", "marker_mm"), [("DICT_5X5_100", None), (None, 12.0)])
def test_dictionary_and_marker_belong_together(charuco: str | None, marker_mm: float | None) -> None:
    """One without the other is wrong input, with an example."""
    with pytest.raises(InputError, match="belong together") as caught:
        make_board_search(charuco, marker_mm, 16.0, partial=False, window_px=None)
    assert "DICT_" in caught.value.hint


def test_picture_that_cannot_be_written_is_a_fault_of_the_machine(tmp_path: Path) -> None:
    """If the path of the picture is a folder, the error names it."""
    lens = Intrinsics((640, 480), 600.0, 600.0, 320.0, 240.0, (0.0,) * 5, {}, 0.1, None, (), False, ())
    assert name_figure(tmp_path / "lens.json") == tmp_path / "lens.png"
    assert name_figure(None) is None
    (tmp_path / "lens.png").mkdir()
    with pytest.raises(DiskError, match=r"cannot write .*lens\.png: Is a directory"):
        draw_figure(tmp_path / "lens.json", lens)
