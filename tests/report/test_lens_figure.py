"""The picture of residuals and coverage beside a calibration."""

from pathlib import Path
from typing import Any

import numpy as np

from labrig.report.lens_figure import write_lens_figure
from labrig.vision.intrinsics import Intrinsics, ViewResidual
from labrig.vision.picture import read_picture

VIEWS = (
    ViewResidual("a.png", 0.1, True, None, ((10.0, 10.0), (500.0, 300.0)), ((0.1, 0.0), (0.0, -0.1))),
    ViewResidual("b.png", 3.0, False, "left out", ((20.0, 20.0),)),
    ViewResidual("c.png", None, False, "no board"),
)


def lens(**known: Any) -> Intrinsics:
    """Return a lens with three views: used, left out, without the board."""
    lens = (-0.1, 0.0, 0.0, 0.0, 0.0)
    return Intrinsics(
        (640, 480), 600.0, 600.0, 320.0, 240.0, lens, {}, 0.1, None, VIEWS, False, ("why",), **known
    )


def test_figure_shows_the_corners_and_what_was_left_out(tmp_path: Path) -> None:
    """The picture has something on it, and changes with the coverage that its title states."""
    pictures = []
    for name, known in (("known.png", {"coverage": 0.5}), ("unknown.png", {})):
        write_lens_figure(tmp_path / name, lens(**known))
        pictures.append(read_picture(tmp_path / name))
    assert all(picture.shape[1] > 700 and np.ptp(picture) > 200 for picture in pictures)
    assert not np.array_equal(pictures[0], pictures[1])
