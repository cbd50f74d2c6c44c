"""Line figures: the same bytes each time, no name space, nothing global left behind."""

from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

from labrig.report.figures import Design, GelSeries, draw_lens, draw_steerability_figure, write_figure
from labrig.report.palette import mark

DESIGN = Design(30.0, 40.0, -1)


def _series() -> list[GelSeries]:
    path = np.column_stack((-np.linspace(0, 20, 30), np.linspace(0, 28, 30)))
    full = GelSeries("10 %", mark(0), (path,), (28.1, 28.3), 28.2, 0.14, (27.9, 28.5), (28.34, 0.247), 28.25)
    empty = GelSeries("13 %", mark(1), (), (), None, None, None, None, None)
    return [full, empty]


def test_a_figure_is_an_element_of_its_own() -> None:
    """Its name stands before every identifier, it brings no address, and matplotlib's settings are as they were."""
    before = dict(mpl.rcParams)
    figure = str(draw_steerability_figure(_series(), DESIGN, "one"))
    assert figure.startswith("<svg")
    assert "http" not in figure
    assert 'id="one-' in figure
    assert 'id="' not in figure.replace('id="one-', "")
    assert 'href="#' not in figure.replace('href="#one-', "")
    assert dict(mpl.rcParams) == before


def test_the_interval_of_two_insertions_does_not_squeeze_the_radii() -> None:
    """It leaves what is drawn; design, radii, means and standard deviations stay in it."""
    wide = replace(_series()[0], ci95_mm=(10.0, 46.0))
    low, high = draw_steerability_figure([wide], DESIGN, "one").figure.axes[1].get_ylim()
    assert 26.0 < low < 28.1
    assert 30.0 < high < 31.0


def test_gels_differ_in_colour_and_in_marker() -> None:
    """Seven gels have seven colours, and no two of thirty groups look the same."""
    assert len({mark(index).colour for index in range(7)}) == 7
    assert len({(mark(index).colour, mark(index).marker) for index in range(30)}) == 30


@pytest.mark.parametrize("form", ["svg", "pdf"])
def test_a_figure_becomes_a_file_for_a_paper(form: str, tmp_path: Path) -> None:
    """The same bytes each time, so that no file changes when nothing has."""
    written = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_figure(tmp_path / name, draw_steerability_figure(_series(), DESIGN, "one"))
        written.append((tmp_path / name / f"one.{form}").read_bytes())
    assert written[0] == written[1]
    assert written[0].startswith({"svg": b"<?xml", "pdf": b"%PDF"}[form])


def test_residuals_of_a_lens_are_drawn_larger_from_their_corners() -> None:
    """With residuals the title says how much larger; without, only the corners are drawn."""
    seen, plain = (
        draw_lens((640, 480), [(((10.0, 20.0), (30.0, 40.0)), errors)], 0.1).axes[0]
        for errors in (((0.1, 0.0), (0.0, -0.1)), ())
    )
    assert "128 times enlarged" in seen.get_title(loc="left")
    assert [np.asarray(line.get_xdata())[-1] for line in seen.lines[1:]] == pytest.approx([22.8, 30.0])
    assert len(plain.lines) == 1
