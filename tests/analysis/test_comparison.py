"""What a comparison counts, and which errors it takes to be shared."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labrig.analysis.comparison import ComparedRuns, compare_runs
from labrig.analysis.measurements import load_runs, open_measured_runs
from labrig.errors import InputError
from tests.analysis.measured_runs import SIGMAS_MM, write_measured_run

SOFT, HARD = ("gel A", 10.0), ("gel B", 19.0)


def _compare(*runs: Path, **options: object) -> ComparedRuns:
    measured, left_out = open_measured_runs(runs)
    return compare_runs(measured, left_out, **options)  # type: ignore[arg-type]


def test_only_final_and_accepted_measurements_count(tmp_path):
    """Pictures on the way are left out, refused and marked ones are counted as refused; the table keeps all apart."""
    radii = {SOFT: (28.0, 28.4, None, 35.0), HARD: (27.0, 27.2)}
    compared = _compare(write_measured_run(tmp_path, "a", radii, bad={3: "a bubble"}))
    soft, hard = compared.comparison.groups
    assert (soft.name, soft.n, soft.refused, soft.mean) == ("N1, 10 % gelatin", 2, 2, pytest.approx(28.2))
    assert (hard.n, hard.mean) == (2, pytest.approx(27.1))
    assert list(compared.table["value"].fillna(-1)) == [28.0, 28.4, -1, -1, 27.0, 27.2]
    assert list(compared.table["left_out"].dropna()) == ["marked as bad: a bubble"]


def test_insertions_into_one_block_are_no_independent_specimens(tmp_path):
    """With a block in each group insertions are counted, and it is said what that is worth; with two, blocks are."""
    first = write_measured_run(tmp_path, "a", {SOFT: (28.0, 28.4), HARD: (27.0, 27.2)})
    alone = _compare(first).comparison
    assert (alone.unit_of_analysis, alone.groups[0].n, alone.groups[0].specimens) == ("insertion", 2, 1)
    assert "these blocks alone" in alone.warnings[0]
    second = write_measured_run(tmp_path, "b", {SOFT: (29.0, 29.2, 29.4), HARD: (26.0,)})
    both = _compare(first, second).comparison
    soft = both.groups[0]
    assert (both.unit_of_analysis, soft.n, soft.insertions, soft.specimens) == ("specimen", 2, 5, 2)
    assert soft.mean == pytest.approx((28.2 + 29.2) / 2)


def test_a_specimen_with_a_file_is_one_block_in_all_runs(tmp_path):
    """Two runs in the same block count one specimen; without its file, nothing says that it is the same."""
    runs = [
        write_measured_run(tmp_path, name, {SOFT: (28.0, 28.4), HARD: (27.0,)}, with_file=["gel A"])
        for name in ("a", "b")
    ]
    soft, hard = _compare(*runs).comparison.groups
    assert (soft.specimens, soft.insertions, hard.specimens, hard.insertions) == (1, 4, 2, 2)


def test_a_shared_error_stays_in_a_mean_and_cancels_in_a_difference_of_one_calibration(tmp_path):
    """Lens and plane cancel where they are the same, the roll of the needle where the run is, and fit is nowhere."""
    a = write_measured_run(tmp_path, "a", {SOFT: (28.0, 28.4), HARD: (27.0, 27.2)})
    b = write_measured_run(tmp_path, "b", {SOFT: (28.1, 28.3)}, needle_id="N2", plane=b'{"other": 1}')
    compared = _compare(a, b).comparison
    parts: list[Any] = [compared.groups[0], *compared.pairs[:2]]
    soft, in_one_run, across = (part.shared_sigma for part in parts)
    known = ("lens", "plane", "surface", "roll")
    assert [soft[name] for name in known] == [pytest.approx(SIGMAS_MM[name]) for name in known]
    assert soft["total"] == pytest.approx(math.sqrt(0.03**2 + 0.04**2 + 0.12**2 + 0.01**2))
    assert (in_one_run["total"], across["lens"]) == pytest.approx((0.0, 0.0), abs=1e-12)
    assert (across["plane"], across["roll"]) == pytest.approx((0.04 * math.sqrt(2), 0.12 * math.sqrt(2)))
    narrow, wide = (np.ptp(ends) / 2 for ends in (parts[2].ci95, parts[2].ci95_with_shared))
    assert wide == pytest.approx(math.hypot(narrow, 1.96 * across["total"]))


def test_results_of_different_settings_are_told(tmp_path):
    """Which setting differs, in which runs, and what was changed after a run."""
    a = write_measured_run(tmp_path, "a", {SOFT: (28.0, 28.4)}, settings={"window_start_mm": 4.0})
    other: Any = {"settings": {"window_start_mm": 6.0}, "overrides": ("analysis.window_start_mm=6",)}
    b = write_measured_run(tmp_path, "b", {HARD: (28.1, 28.3)}, **other)
    compared = _compare(a, b).comparison
    told = " ".join(compared.warnings)
    assert "window_start_mm is 4.0 in a; 6.0 in b" in told
    assert "Result 1 of b has settings changed after the run: analysis.window_start_mm=6" in told


def test_groups_can_be_made_by_any_field(tmp_path):
    """By a column, an alias, a key of the protocol or the run; the default falls back on runs that are all alike."""
    a = write_measured_run(tmp_path, "a", {SOFT: (28.0, 28.4)})
    b = write_measured_run(tmp_path, "b", {SOFT: (28.1, 28.3)}, needle_id="N2")
    c = write_measured_run(tmp_path, "c", {SOFT: (28.1, 28.3)})
    names = {
        by: [g.name for g in _compare(a, b, by=(by,)).comparison.groups] for by in ("needle", "hole", "title")
    }
    assert names == {"needle": ["N1", "N2"], "hole": ["hole 0", "hole 1"], "title": ["title a", "title b"]}
    alike = _compare(a, c).comparison
    assert (alike.by, [group.name for group in alike.groups]) == (("run",), ["a", "c"])


@pytest.mark.parametrize(
    ("radii", "options", "message"),
    [
        ({SOFT: (28.0, 28.4)}, {}, "nothing to compare: there is only one group: N1, 10 % gelatin"),
        ({SOFT: (None, None), HARD: (None,)}, {}, "no measurement of radius_mm was accepted"),
        ({SOFT: (28.0, 28.4), HARD: (27.0, 27.2)}, {"by": ("nedle",)}, "and no run has that field"),
        ({SOFT: (28.0, 28.4), HARD: (27.0, 27.2)}, {"quantity": "radius"}, "no quantity 'radius'"),
    ],
)
def test_nothing_to_compare_is_refused(tmp_path, radii, options, message):
    """A single group, measurements of which none was accepted, and what no run has, with the nearest name."""
    with pytest.raises(InputError, match=message) as caught:
        _compare(write_measured_run(tmp_path, "a", radii), **options)
    assert not options or re.search("did you mean (needle|radius_mm)", caught.value.hint)


def test_groups_of_one_and_without_spread_are_listed_and_not_tested(tmp_path):
    """Each is told; the other groups are tested, and equal values give no test that would divide by nothing."""
    radii = {SOFT: (28.0,), HARD: (27.0, 27.0), ("gel C", 13.0): (27.5, 27.9)}
    compared = _compare(write_measured_run(tmp_path, "a", radii)).comparison
    assert [group.n for group in compared.groups] == [1, 2, 2]
    assert compared.welch_anova is None
    assert [(pair.a, pair.p is None) for pair in compared.pairs] == [("N1, 13 % gelatin", False)]
    told = " ".join(compared.warnings)
    assert "N1, 10 % gelatin has n = 1: it is listed, but not tested." in told
    assert "All values are the same in N1, 19 % gelatin" in told


def test_load_runs_gives_the_measurements_as_one_table(tmp_path):
    """A row for each final picture, refused ones too, with the time of its trial; a run without result is told."""
    write_measured_run(tmp_path, "a", {SOFT: (28.0, None)})
    write_measured_run(tmp_path, "b", {HARD: (27.0,)}, needle_id="N2")
    empty = write_measured_run(tmp_path, "c", {SOFT: (28.0,)}, result=False)
    with pytest.warns(UserWarning, match="1 runs are left out"):
        table = load_runs(runs_dir=tmp_path)
    assert list(table["radius_mm"].fillna(-1).groupby(table["run"]).sum()) == [27.0, 27.0]
    started = list(table.loc[table["run"] == "a", "started"])
    assert started == ["2026-03-02T09:30:00+00:00", "2026-03-02T09:31:00+00:00"]
    assert list(table.attrs["left_out"]) == [str(empty)]
    assert list(load_runs("seed=7 and title=b", runs_dir=tmp_path)["needle_id"]) == ["N2"]
