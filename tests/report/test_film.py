"""Films of recorded pictures."""

import numpy as np

from labrig.report.film import draw_film_picture
from labrig.report.film_pictures import FilmPicture, Stroke

_GREY = np.full((600, 1920), 90, dtype=np.uint8)
_LEVEL = Stroke(np.array([(192.0, 300.0), (1728.0, 300.0)]), (255, 0, 0), 3, "plan")


def test_a_line_lies_where_it_was_measured_in_the_reduced_picture() -> None:
    """Colours are told as red, green, blue; under the picture stands the caption, and behind it what each line is."""
    drawn = draw_film_picture(_GREY, FilmPicture(0, (_LEVEL,), "12.5 mm"))
    assert drawn.shape == (340, 960, 3)
    red = (drawn[:300, :, 2] > 150) & (drawn[:300, :, 0] < 90)
    rows, columns = np.nonzero(red)
    assert abs(rows.mean() - 150) < 0.5
    assert abs(int(columns.min()) - 96) <= 2
    assert abs(int(columns.max()) - 864) <= 2
    strip = drawn[300:].astype(int)
    is_key = strip[..., 2] - strip[..., 0] > 100
    caption, key = np.nonzero(strip.min(axis=2) > 150)[1], np.nonzero(is_key)[1]
    assert 0 < caption.max() < key.min()
