"""Figures and films: what is drawn where, the same bytes each time, nothing global left behind."""

import json
import re
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from numpy.typing import NDArray

from labrig.library.scenario import load_scenario, make_problem
from labrig.report.figures import (
    Design,
    GelSeries,
    clip_to_corners,
    draw_lens,
    draw_steerability_figure,
    write_figure,
)
from labrig.report.film import draw_film_picture
from labrig.report.film_pictures import FilmPicture, Stroke
from labrig.report.palette import mark
from labrig.report.pictures import map_path
from labrig.report.plan_figure import _draw_view
from labrig.steering.planner import plan_path
from tests.cli.conftest import SCENARIO

DESIGN = Design(30.0, 40.0, -1)


def _series() -> list[GelSeries]:
    path = np.column_stack((-np.linspace(0, 20, 30), np.linspace(0, 28, 30)))
    full = GelSeries("10 %", mark(0), (path,), (28.1, 28.3), 28.2, 0.14, (27.9, 28.5), (28.34, 0.247), 28.25)
    return [full, GelSeries("13 %", mark(1), (), (), None, None, None, None, None)]


def test_a_figure_is_an_element_of_its_own() -> None:
    """Its name stands before every identifier, it brings no address, and matplotlib's settings are as they were."""
    before = dict(mpl.rcParams)
    figure = str(draw_steerability_figure(_series(), DESIGN, "one"))
    assert figure.startswith("<svg")
    assert "http" not in figure
    assert 'id="one-' in figure
    assert 'id="' not in figure.replace('id="one-', "")
    assert 'href="#' not in figure.replace('href="#one-', "")
    assert re.search(r'^<svg class="wide" role="img" aria-label="Figure: [^"]*radius', figure, re.IGNORECASE)
    assert dict(mpl.rcParams) == before


def test_a_telephone_sees_the_panels_below_each_other() -> None:
    """The second element is narrow and tall, and the figure itself is left as it was."""
    drawn = draw_steerability_figure(_series(), DESIGN, "one")
    sizes = [[float(size) for size in box.split()[2:]] for box in re.findall(r'viewBox="([^"]*)"', drawn)]
    (wide, high), (narrow, tall) = sizes
    assert re.findall(r'class="(wide|slim)"', drawn) == ["wide", "slim"]
    assert narrow < 0.5 * wide
    assert tall > 1.2 * high
    assert drawn.figure.axes[0].get_position().x1 < drawn.figure.axes[1].get_position().x0


def test_a_line_ends_where_no_corner_was_seen_and_a_true_path_ends_where_the_map_puts_it() -> None:
    """Within a square of corners half of the line is left; without a corner all. A path moves as the map does."""
    line, square = np.array(((5.0, 5.0), (15.0, 5.0))), [[(0, 0), (10, 0), (10, 10), (0, 10)]]
    np.testing.assert_allclose(clip_to_corners(line, square), ((5.0, 5.0), (10.0, 5.0)), atol=0.02)
    np.testing.assert_allclose(clip_to_corners(line, []), line)
    moved = map_path([(0.0, 0.0), (3.7, 100.0)], (3.8, 100.0), (4.0, 99.0))
    np.testing.assert_allclose(moved, ((0.0, 0.0), (3.9, 99.0)))


def list_points(line: Line2D) -> NDArray[np.float64]:
    """Return the points (N, 2) of a drawn line."""
    return np.column_stack((np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)))


def test_paths_and_radii_are_drawn_where_they_were_measured() -> None:
    """Depth to the right and sideways upwards; in the gel's column each radius, its mean and the mean of the drawn."""
    series = _series()
    paths, radii = draw_steerability_figure(series, DESIGN, "one").figure.axes
    measured, design = (list_points(paths.lines[place]) for place in (0, len(series) + 1))
    assert np.array_equal(measured, series[0].paths_mm[0][:, ::-1])
    assert np.hypot(design[:, 0], design[:, 1] + 30.0) == pytest.approx(30.0)
    bars = (np.asarray(path.vertices, float) for bars in radii.collections for path in bars.get_paths())
    points = np.vstack((*map(list_points, radii.lines[1:]), *bars))
    drawn = {(round(float(x)), round(float(y), 2)) for x, y in points if np.isfinite((x, y)).all()}
    assert {(0, 28.1), (0, 28.3), (0, 28.2), (0, 28.25), (0, 28.34)} <= drawn


@pytest.mark.parametrize("across", [0, 1])
def test_a_plan_is_drawn_where_it_lies(across: int, tmp_path: Path) -> None:
    """Depth to the right and x or y upwards: obstacles, target, start and path, which ends at the target."""
    (tmp_path / "s.json").write_text(json.dumps(SCENARIO | {"planar": False}), encoding="utf-8")
    problem = make_problem(load_scenario(tmp_path / "s.json"))
    axes = Figure().subplots()
    _draw_view(axes, problem, plan_path(problem), across)
    centres = [tuple(patch.center) for patch in axes.patches if isinstance(patch, Circle)]
    places = [(at[2], at[across]) for at in ([0, -2, 35], [0, 6, 68], [0, 5, 100])]
    assert centres == [place for place, times in zip(places, (2, 2, 1), strict=True) for _ in range(times)]
    lines = {str(line.get_label()): list_points(line) for line in axes.lines}
    assert [lines[name][0].tolist() for name in ("path", "start")] == [[0.0, 0.0]] * 2
    assert np.hypot(*(lines["path"][-1] - places[-1])) <= 2.0


def test_a_figure_becomes_files_for_a_paper(tmp_path: Path) -> None:
    """The same bytes each time, so that no file changes when nothing has."""
    for folder in (tmp_path / "a", tmp_path / "b"):
        folder.mkdir()
        write_figure(folder, draw_steerability_figure(_series(), DESIGN, "one"))
    for name, magic in (("one.svg", b"<?xml"), ("one.pdf", b"%PDF")):
        content = (tmp_path / "a" / name).read_bytes()
        assert (content[: len(magic)], content) == (magic, (tmp_path / "b" / name).read_bytes())


def test_residuals_of_a_lens_are_drawn_larger_from_their_corners() -> None:
    """With residuals the title says how much larger; without, only the corners are drawn."""
    seen, plain = (
        draw_lens((640, 480), [(((10.0, 20.0), (30.0, 40.0)), errors)], 0.1).axes[0]
        for errors in (((0.1, 0.0), (0.0, -0.1)), ())
    )
    assert "128 times enlarged" in seen.get_title(loc="left")
    assert [np.asarray(line.get_xdata())[-1] for line in seen.lines[1:]] == pytest.approx([22.8, 30.0])
    assert len(plain.lines) == 1


def test_a_line_lies_where_it_was_measured_in_the_reduced_picture() -> None:
    """Colours are told as red, green, blue; under the picture stands the caption, and behind it what each line is."""
    grey = np.full((600, 1920), 90, dtype=np.uint8)
    level = Stroke(np.array([(192.0, 300.0), (1728.0, 300.0)]), (255, 0, 0), 3, "plan")
    drawn = draw_film_picture(grey, FilmPicture(0, (level,), "12.5 mm"))
    assert drawn.shape == (340, 960, 3)
    rows, columns = np.nonzero((drawn[:300, :, 2] > 150) & (drawn[:300, :, 0] < 90))
    assert abs(rows.mean() - 150) < 0.5
    assert [int(columns.min()), int(columns.max())] == pytest.approx([96, 864], abs=2)
    strip = drawn[300:].astype(int)
    caption, key = np.nonzero(strip.min(axis=2) > 150)[1], np.nonzero(strip[..., 2] - strip[..., 0] > 100)[1]
    assert 0 < caption.max() < key.min()
