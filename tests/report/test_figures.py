"""Line figures: the same bytes each time, no name space, nothing global left behind."""

import matplotlib as mpl
import numpy as np
import pandas as pd

from labrig.report.figures import (
    Design,
    GelSeries,
    draw_coverage_figure,
    draw_residual_figure,
    draw_steerability_figure,
)
from labrig.report.load_figure import draw_load_figure
from labrig.report.palette import mark

DESIGN = Design(30.0, 40.0, -1)


def _series() -> list[GelSeries]:
    path = np.column_stack((-np.linspace(0, 20, 30), np.linspace(0, 28, 30)))
    full = GelSeries("10 %", mark(0), (path,), (28.1, 28.3), 28.2, 0.14, (27.9, 28.5), (28.34, 0.247), 28.25)
    empty = GelSeries("13 %", mark(1), (), (), None, None, None, None, None)
    return [full, empty]


def test_the_same_data_give_the_same_bytes() -> None:
    """Drawn twice, the figure is the same, so that a page does not change when nothing has."""
    assert draw_steerability_figure(_series(), DESIGN, "a") == draw_steerability_figure(
        _series(), DESIGN, "a"
    )


def test_two_figures_of_a_page_share_no_identifier() -> None:
    """The figure's name stands before every identifier and every reference to one."""
    figure = str(draw_residual_figure([("0", 0.1), ("1", 0.2)], 0.15, "one"))
    assert 'id="one-' in figure
    assert 'id="' not in figure.replace('id="one-', "")
    assert 'href="#' not in figure.replace('href="#one-', "")


def test_a_figure_brings_no_address_and_no_settings() -> None:
    """No name space is left in the element, and matplotlib's settings are as they were."""
    before = dict(mpl.rcParams)
    figure = str(draw_coverage_figure({"a": np.array([[10.0, 20.0]])}, (640, 480), "c"))
    assert "http" not in figure
    assert figure.startswith("<svg")
    assert dict(mpl.rcParams) == before


def test_gels_differ_in_colour_and_in_marker() -> None:
    """Seven gels have seven colours, and no two of thirty groups look the same."""
    assert len({mark(index).colour for index in range(7)}) == 7
    assert len({(mark(index).colour, mark(index).marker) for index in range(30)}) == 30


def test_the_currents_of_a_run_are_drawn_where_it_has_some() -> None:
    """A record of before has no such columns, and a drive without a measurement has none in its column."""
    states = pd.DataFrame(
        {
            "insertion_mm": [0.0, 0.4, 1.6, 0.8],
            "linear_mm": [0.0] * 4,
            "insertion_current_ma": [0.0, 60.0, 61.0, -60.0],
            "linear_current_ma": [None] * 4,
        }
    )
    drawn = draw_load_figure(states, "load")
    assert drawn is not None
    assert all(word in drawn for word in ("Insertion axis", "forwards", "backwards"))
    assert "Linear axis" not in drawn
    assert draw_load_figure(states[["insertion_mm", "linear_mm"]], "load") is None
    assert draw_load_figure(states.iloc[:0], "load") is None
