"""What a comparison counts, which errors it takes to be shared, and its tests of means against published results."""

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from labrig.analysis.comparison import ComparedRuns, compare_runs
from labrig.analysis.measurements import load_runs, open_measured_runs
from labrig.analysis.statistics import (
    add_roll_uncertainty,
    compare_means,
    compare_pairs,
    compute_spread,
    has_spread,
)
from labrig.errors import InputError
from labrig.report.comparison_page import write_comparison
from tests.analysis.measured_runs import SIGMAS_MM, write_measured_run
from tests.record.runs import ENDED

SOFT, HARD = ("gel A", 10.0), ("gel B", 19.0)


def _compare(*runs: Path, **options: object) -> ComparedRuns:
    measured, left_out = open_measured_runs(runs)
    return compare_runs(measured, left_out, **options)  # type: ignore[arg-type]


def test_only_final_and_accepted_measurements_count(tmp_path):
    """Pictures on the way are left out, refused and marked ones are counted as refused; the table keeps all apart."""
    radii = {SOFT: (28.0, 28.4, None, 35.0), HARD: (27.0, 27.2)}
    compared = _compare(write_measured_run(tmp_path, "a", radii, bad={3: "a bubble"}))
    soft, hard = compared.comparison.groups
    assert (soft.name, soft.n, soft.refused, soft.mean) == ("10 % gelatin", 2, 2, pytest.approx(28.2))
    assert (hard.n, hard.mean) == (2, pytest.approx(27.1))
    assert list(compared.table["value"].fillna(-1)) == [28.0, 28.4, -1, -1, 27.0, 27.2]
    assert list(compared.table["left_out"].dropna()) == ["marked as bad: a bubble"]


def test_pictures_of_a_trial_without_a_final_one_count_as_one_measurement(tmp_path):
    """Their mean is that of the trial; grouped by picture they stand apart."""
    run = write_measured_run(tmp_path, "a", {SOFT: (28.0, 28.4), HARD: (27.0, 27.2)}, final=False)
    soft, hard = _compare(run).comparison.groups
    assert (soft.n, soft.mean, hard.n, hard.mean) == (2, pytest.approx(63.6), 2, pytest.approx(63.05))
    by_role = _compare(run, by=("role",)).comparison.groups
    assert [(g.n, g.mean) for g in by_role] == [(2, 99.0), (2, pytest.approx(27.65))]  # of two gels each


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


def test_a_mean_over_runs_takes_their_mounting_as_one_and_a_difference_as_two(tmp_path):
    """No record says whether the needle was mounted anew: each interval is that of the wider of the two."""
    a = write_measured_run(tmp_path, "a", {SOFT: (28.0, 28.4)})
    b = write_measured_run(tmp_path, "b", {SOFT: (28.1, 28.3), HARD: (27.0, 27.2)})
    compared: Any = _compare(a, b).comparison
    sigmas = [part.shared_sigma["roll"] for part in (compared.groups[0], compared.pairs[0])]
    assert sigmas == pytest.approx([0.12, 0.12 * math.sqrt(0.5)])


def test_results_of_different_settings_are_told(tmp_path):
    """Which setting differs, in which runs, and what was changed after a run."""
    a = write_measured_run(tmp_path, "a", {SOFT: (28.0, 28.4)}, settings={"window_start_mm": 4.0})
    other: Any = {"settings": {"window_start_mm": 6.0}, "overrides": ("analysis.window_start_mm=6",)}
    b = write_measured_run(tmp_path, "b", {HARD: (28.1, 28.3)}, **other)
    told = " ".join(_compare(a, b).comparison.warnings)
    assert "The settings of the runs differ in window start (4 mm in a; 6 mm in b)." in told
    assert "Result 1 of b has settings changed after the run: analysis.window_start_mm=6" in told


def test_what_protocols_and_rigs_say_otherwise_is_named(tmp_path):
    """A key with its values and runs; what names a run or its groups is expected to differ."""
    a = write_measured_run(tmp_path, "a", {SOFT: (28.0, 28.4)})
    other = "analysis: {window_start_mm: 6.0}\nnotes: other\n"
    b = write_measured_run(tmp_path, "b", {HARD: (28.1, 28.3)}, protocol=other, rig="simulated")
    told = [line for line in _compare(a, b).comparison.warnings if "settings" in line]
    differing = "rig.kind (bench in a; simulated in b), analysis window start (not stated in a; 6 mm in b)"
    assert told == [f"The settings of the runs differ in {differing}."]


def test_the_interval_of_a_distance_begins_at_zero(tmp_path):
    """Student's of two errors at a target would begin below it; its other end stays."""
    a, b = (
        write_measured_run(tmp_path, name, {SOFT: values}, quantity="target_error_mm")
        for name, values in (("a", (0.1, 0.9)), ("b", (0.2, 0.3)))
    )
    ends = [group.ci95 for group in _compare(a, b).comparison.groups]
    assert ends == [(0.0, pytest.approx(0.5 + 12.706 * 0.4, rel=1e-3)), (0.0, pytest.approx(0.885, abs=1e-3))]


def test_how_far_from_its_target_a_needle_was_broken_off_is_no_error(tmp_path):
    """One that was stopped on the way, or had no path left, counts as refused; a miss has its error."""
    errors = {SOFT: (1.0, 3.0, 80.0, 60.0), HARD: (1.0,)}
    (run,), _ = open_measured_runs([write_measured_run(tmp_path, "a", errors, quantity="target_error_mm")])
    rows = run.tables["measurements"]
    outcome, refused = np.where(rows["trial"] == 3, "stopped", "missed"), rows["trial"].map({2: "blocked"})
    rows = rows.assign(outcome=outcome, refused=refused)
    soft = compare_runs([replace(run, tables={"measurements": rows})]).comparison.groups[0]
    assert (soft.n, soft.refused, soft.mean) == (2, 2, 2.0)


@pytest.mark.parametrize(("low_mm", "told"), [(0.9, "cannot be told apart: "), (1.1, "insertions differ: ")])
def test_insertions_are_told_apart_by_their_intervals_in_space(tmp_path, low_mm, told):
    """Not by what the shaft says in the plane; the figure has an axis of that name, and letters for long names."""
    runs = [tmp_path / "20261127-insertion", tmp_path / "paper"]
    for run, error_mm in zip(runs, (0.1, 0.7), strict=True):
        write_measured_run(tmp_path, run.name, {SOFT: (error_mm,)}, quantity="target_error_mm")
    measured = [replace(run, not_in_interval=("height of the paper",)) for run in open_measured_runs(runs)[0]]
    compared = compare_runs(measured)
    table = compared.table.assign(target_error_low_mm=(0.1, low_mm), target_error_high_mm=(1.0, 2.0))
    write_comparison(tmp_path, replace(compared, table=table), ENDED, measured)
    page = re.sub("</?span.*?>", "", (tmp_path / "report.html").read_text(encoding="utf-8"))
    assert (told in page, "error at the target in space (mm)" in page) == (True, True)
    assert f"Run A is {runs[0].name}, run B is {runs[1].name}." in page
    assert "no interval holds it: height of the paper." in page  # a word that is also a name


def test_the_same_simulation_twice_is_said_to_be_one_measurement(tmp_path):
    """Runs of a simulated rig and one seed repeat one another where needle, gel and hole have the same names."""
    for rig, told, n in (("simulated", ["1 simulated gel is"], 2), ("bench", [], 3)):
        runs = [
            write_measured_run(tmp_path / rig, *of, rig=rig)
            for of in (("a", {SOFT: (28.0, 28.4)}), ("b", {HARD: (28.0, 28.4)}))
        ]
        runs.append(
            write_measured_run(tmp_path / rig, "c", {HARD: (27.0,)}, rig=rig, protocol="insertion_count: 2\n")
        )
        warned = _compare(*runs, by=["run"]).comparison.warnings
        assert [line.partition(" in more")[0] for line in warned if "simula" in line] == told
        both = _compare(*runs).comparison  # b and c are in one group
        counted = [line.startswith("b, c have insertions in common, of one seed") for line in both.warnings]
        assert ([group.n for group in both.groups], sum(counted)) == ([2, n], 3 - n)


def test_an_insertion_that_one_run_repeats_weighs_no_more_in_its_block(tmp_path):
    """The block's mean is that of its insertions, 28 and 29 mm, not of three measurements."""
    drawn = {SOFT: (28.0, 29.0), ("gel C", 10.0): (28.0,), HARD: (27.0,), ("gel D", 19.0): (27.0,)}
    whole = write_measured_run(tmp_path, "a", drawn, rig="simulated")
    again = write_measured_run(tmp_path, "b", {SOFT: (28.0,)}, rig="simulated", plane=b"{ }")
    soft = _compare(whole, again).comparison.groups[0]
    assert soft.mean == pytest.approx((28.5 + 28.0) / 2)
    assert soft.shared_sigma["plane"] == pytest.approx(0.04 * math.hypot(7 / 8, 1 / 8))  # of two maps


def test_groups_can_be_made_by_any_field(tmp_path):
    """By a column, an alias, a key of the protocol or the run; the default falls back on runs that are all alike."""
    a = write_measured_run(tmp_path, "a", {SOFT: (28.0, 28.4)})
    b = write_measured_run(tmp_path, "b", {SOFT: (28.1, 28.3)}, needle_id="N2")
    policy = "planner: {{method: {}}}\npolicy: {{near_mm: {}}}\n"
    c = write_measured_run(tmp_path, "c", {SOFT: (28.1, 28.3)}, protocol=policy.format("paper", 0))
    d = write_measured_run(tmp_path, "d", {SOFT: (28.1, 28.3)}, protocol=policy.format("best", 30))
    named = {"needle": ["N1", "N2"], "hole": ["hole 1", "hole 2"], "title": ["title a", "title b"]}
    assert {by: [g.name for g in _compare(a, b, by=(by,)).comparison.groups] for by in named} == named
    alike = _compare(a, c).comparison
    assert (alike.by, [group.name for group in alike.groups]) == (("run",), ["a", "c"])
    policies = _compare(c, d).comparison  # what each policy says is no other setting
    assert [group.name for group in policies.groups] == ["default policy", "paper policy"]
    assert not [line for line in policies.warnings if "settings" in line]


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
    assert [(pair.a, pair.p is None) for pair in compared.pairs] == [("13 % gelatin", False)]
    told = " ".join(compared.warnings)
    assert "Listed, but not tested, for less than two values: 10 % gelatin." in told
    assert "All values are the same in 19 % gelatin" in told


def test_load_runs_gives_the_measurements_as_one_table(tmp_path):
    """A row for each final picture, refused ones too, with the time of its trial; a run without result is told."""
    write_measured_run(tmp_path, "a", {SOFT: (28.0, None)})
    write_measured_run(tmp_path, "b", {HARD: (27.0,)}, needle_id="N2")
    empty = write_measured_run(tmp_path, "c", {SOFT: (28.0,)}, result=False)
    with pytest.warns(UserWarning, match=r"runs left out \(1\): c; see"):
        table = load_runs(runs_dir=tmp_path)
    assert list(table["radius_mm"].fillna(-1).groupby(table["run"]).sum()) == [27.0, 27.0]
    started = list(table.loc[table["run"] == "a", "started"])
    assert started == ["2026-03-02T09:30:00+00:00", "2026-03-02T09:31:00+00:00"]
    assert list(table.attrs["left_out"]) == [str(empty)]
    assert list(load_runs("seed=7 and title=b", runs_dir=tmp_path)["needle_id"]) == ["N2"]


# Dobson (1983), PlantGrowth of R: weights of plants with a control and two treatments. pingouin's `welch_anova` and
# `pairwise_gameshowell` printed the numbers; R's `oneway.test` prints the same F, degrees of freedom and p.
GROWTH = (
    [4.17, 5.58, 5.18, 6.11, 4.50, 4.61, 5.17, 4.53, 5.33, 5.14],
    [4.81, 4.17, 4.41, 3.59, 5.87, 3.83, 6.03, 4.89, 4.32, 4.69],
    [6.31, 5.12, 5.54, 5.50, 5.37, 5.29, 4.92, 6.15, 5.80, 5.26],
)
WELCH = (5.18097240811319, 17.12841861664413, 0.017392821490169984)
GAMES_HOWELL = {(0, 1): 0.4745549222, (0, 2): 0.1128891769, (1, 2): 0.0237034547}


@pytest.mark.parametrize(
    ("values", "mean", "sd", "half"),
    [((1.0, 2.0, 3.0), 2.0, 1.0, 2.4841), ((28.3,), 28.3, None, None), ((), None, None, None)],
)
def test_a_spread_is_that_of_the_tables(values, mean, sd, half):
    """1, 2, 3: t(0.975, 2) = 4.303 puts the interval at 2 -+ 2.484; a single value has no spread, and none no mean."""
    found = compute_spread(values)
    assert (found.n, found.mean, found.sd) == (len(values), mean, sd)
    expected = None if mean is None or half is None else pytest.approx((mean - half, mean + half), abs=1e-4)
    assert found.ci95 == expected


def test_the_interval_covers_as_often_as_it_says():
    """The 95 % intervals of 4000 samples of 18 normal radii hold the true mean in 95 % of cases, within 1.5 %."""
    samples = np.random.default_rng(20260).normal(27.6, 0.4, (4000, 18))
    ends = np.array([compute_spread(list(sample)).ci95 for sample in samples]) - 27.6
    assert np.mean(ends[:, 0] * ends[:, 1] < 0) == pytest.approx(0.95, abs=0.015)


def test_the_roll_moves_both_ends_of_an_interval_where_the_camera_is_known():
    """Perspective is linear in the roll; its share is independent of the scatter, and shared by all insertions.

    Without a camera it moves the lower end alone: at two degrees by 1 - cos(1.96 x 2 degrees), 0.23 %.
    """
    both = (28.2 - math.hypot(0.2, 0.294), 28.2 + math.hypot(0.2, 0.294))
    assert add_roll_uncertainty((28.0, 28.4), 2.0, 0.15) == pytest.approx(both)
    assert add_roll_uncertainty((28.0, 28.4), 2.0) == pytest.approx((28.0 * 0.99766, 28.4), abs=1e-3)
    assert add_roll_uncertainty((28.0, 28.4), 0.0) == (28.0, 28.4)
    assert add_roll_uncertainty(None, 2.0) is None


@pytest.mark.processors
def test_public_data_give_the_published_results():
    """Welch's F, degrees of freedom and p, and p of pairs, are those of pingouin; an interval of a pair is scipy's."""
    welch = compare_means(GROWTH)
    assert (welch.f, welch.df_within, welch.p) == pytest.approx(WELCH, rel=1e-9)
    assert welch.df_between == 2.0
    pairs = compare_pairs(GROWTH)
    whole = stats.tukey_hsd(*GROWTH, equal_var=False).confidence_interval(0.95)
    low, high = np.asarray(whole.low), np.asarray(whole.high)
    for (a, b), p in GAMES_HOWELL.items():
        assert pairs[a, b].p == pytest.approx(p, abs=1e-8)
        assert pairs[a, b].difference == pytest.approx(np.mean(GROWTH[a]) - np.mean(GROWTH[b]))
        assert pairs[a, b].ci95 == pytest.approx((low[a, b], high[a, b]), rel=1e-5)
    # Values without a spread are refused and not divided by.
    assert compare_means([[1.0, 2.0]]) is compare_means([[1.0, 2.0], [3.0, 3.0]]) is None
    assert not has_spread([27.6])
    assert not has_spread([27.6, 27.6])
