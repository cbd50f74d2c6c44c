"""Which pictures a live view draws of those that wait."""

from pathlib import Path

import pytest

from labrig.record.events import FrameLine
from labrig.record.following import LinedPicture
from labrig.record.pictures import RecordedPicture
from labrig.report.live_view import choose_pictures


def _picture(frame: int) -> LinedPicture:
    line = FrameLine(t_s=float(frame), frame=frame, file="", role="final" if frame == 1 else "advance")
    return LinedPicture(line, RecordedPicture(Path(), "", ""))


@pytest.mark.parametrize(("waiting", "drawn"), [(2, [0, 1]), (6, [1, 4, 5])])
def test_the_newest_and_the_needed_pictures_are_drawn(waiting: int, drawn: list[int]) -> None:
    """Of many pictures the newest are drawn, and those from which something is measured."""
    pictures = [_picture(frame) for frame in range(waiting)]
    chosen = choose_pictures(pictures, lambda line: line.role == "final", most=2)
    assert [picture.line.frame for picture in chosen] == drawn
