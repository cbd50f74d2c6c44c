"""Films of recorded pictures."""

import cv2
import numpy as np

from labrig.report.film import draw_film_picture
from labrig.report.film_pictures import FilmPicture, Stroke

_GREY = np.full((600, 1920), 90, dtype=np.uint8)
_LEVEL = Stroke(np.array([(192.0, 300.0), (1728.0, 300.0)]), (255, 0, 0), 3, "plan")


def test_a_line_lies_where_it_was_measured_in_the_reduced_picture() -> None:
    """Pixels are those of the recorded picture; colours are told as red, green, blue."""
    drawn = draw_film_picture(_GREY, FilmPicture(0, (_LEVEL,), "12.5 mm"))
    assert drawn.shape == (340, 960, 3)
    red = (drawn[:300, :, 2] > 150) & (drawn[:300, :, 0] < 90)
    rows, columns = np.nonzero(red)
    assert abs(rows.mean() - 150) < 0.5
    assert abs(int(columns.min()) - 96) <= 2
    assert abs(int(columns.max()) - 864) <= 2
    assert cv2.countNonZero(drawn[300:, :, 1]) > 0


def test_a_key_that_does_not_fit_is_left_out() -> None:
    """The caption is never written over."""
    small = np.full((60, 200), 90, dtype=np.uint8)
    strokes = (Stroke(_LEVEL.px / 10, (255, 0, 0), 1, "estimate"),)
    drawn = draw_film_picture(small, FilmPicture(0, strokes, "12.5 mm inserted"))
    strip = drawn[60:].astype(int)
    assert strip.max() > 200
    assert np.all(abs(strip[..., 2] - strip[..., 0]) < 5)
