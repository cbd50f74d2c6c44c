"""The page of an insertion run: figure 9."""

import re
from dataclasses import replace
from typing import Any

import pytest
from scipy.stats import chi2

from labrig.analysis.run import analyze_run
from labrig.devices.drives.states import describe_statusword
from labrig.experiments.insertion.result import EndDepth, InsertionResult
from labrig.experiments.registry import find_run_experiment, follow_run, load_run_result, make_run_view
from labrig.record.reader import open_run
from labrig.report.rerun_view import write_view
from labrig.report.view import NO_VIEW
from tests.analysis.synthetic import NOW, PROVENANCE
from tests.experiments.insertion.recorded import analyse_recorded, record_insertion
from tests.pages import write_page
from tests.rerun_files import read_view


@pytest.fixture(scope="module")
def html() -> str:
    """Return the page of an insertion past one obstacle."""
    analyse_recorded()
    run = open_run(record_insertion().path)
    return write_page(run, load_run_result(run, 1), NOW).read_text(encoding="utf-8")


def test_each_replan_has_its_picture_with_everything_in_it(html: str) -> None:
    """Each shows depth, time, scale, plans, obstacle and target; the last, which opens the page, path and truth too."""
    last, *others = re.findall(r'<svg class="view"[^>]*><g .*?</svg>', html, re.DOTALL)
    plates = [*others, last]
    assert len(plates) >= 3
    for plate in plates:
        assert plate.count('class="obstacle"') == 1
        assert plate.count('class="target"') == 3
        assert 'class="bar"' in plate
        assert re.search(r"\d+\.\d\u00a0mm inserted, \d+\u00a0s</text>", plate)
    assert all('class="plan"' in plate for plate in plates[:-1])
    assert 'class="former"' in plates[-2]
    assert 'class="taken"' in plates[-1]
    assert 'class="true"' in plates[-1]


@pytest.mark.parametrize(
    "pattern",
    [
        "origins.csv", "planned from where the sheath was found", "how far the estimate is off", "Clearance", "NIS",
        "Reached: the needle's end is <b>0",
        r"In the plane it is <b>0\.\d\d\u00a0mm</b> \(SD 0\.\d\d\u00a0mm\) off, by the shaft in the final picture",
        r"needle's end is <b>\d\.\d\d to \d\.\d\d\u00a0mm</b> from the target in space \(95\u00a0% interval\)",
        r"\(95\u00a0% interval\), by [a-z ]+, where 2\u00a0mm are allowed",
        "true distance .* which is within the interval",
        r"the plane map is off by \d\.\d\d\u00a0mm at the target.* both are off alike", "true distance", "Heading",
        "<dd>sphere of radius .*mm at y .*, z .*mm</dd>", r"degrees \(SD\), certified before", "truth",
        r"errors that the innovations hardly show.*and what the plane map is off", "<dt>NIS</dt>", "<h3>In space</h3>",
        ">Roll zero<", ">Lag of the bevel<", ">Wandering<", ">Start<", ">Place in the picture<", "The simulated world",
        "To &lt;b&gt;there&lt;/b&gt;", "as far as the protocol's standard deviations are true",
    ],
)  # fmt: skip
def test_the_page_tells_how_near_it_ended_by_what_and_how_sure_that_is(html: str, pattern: str) -> None:
    """The sheath, the four curves, the errors, the interval in space with its sources; a title's markup is text."""
    assert re.search(pattern, html)
    assert "<b>there" not in html


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"outcome": "missed", "stop": "left_the_plane", "reached": False,
          "target_error_interval_mm": (2.67, 4.4)}, "Missed: "),
        ({"outcome": "reached_in_plane_only", "stop": "left_the_plane", "reached": None},
         "In the plane the target was reached; in space it is not known: "),
        ({"clearance_mm": -0.22},
         r"By the estimate the needle touched obstacle 1: its tip was <b>0\.22\u00a0mm</b>"),
    ],
)  # fmt: skip
def test_the_opening_gives_one_reason_and_says_what_was_touched(change: dict[str, Any], told: str) -> None:
    """An interval beyond the tolerance is not reached; what was measured out of the plane, one camera did see."""
    analyse_recorded()
    run = open_run(record_insertion().path)
    result = load_run_result(run, 1)
    assert isinstance(result.content, InsertionResult)
    (trial,) = result.content.insertions
    step = trial.steps[-1].model_copy(update=change)
    left = EndDepth(x_mm=3.4, sd_mm=0.4, picture_x_mm=3.4, picture_sd_mm=0.4, contradicts=True)
    ended = trial.model_copy(update={"depth": left, **change, "steps": (*trial.steps[:-1], step)})
    content = result.content.model_copy(update={"insertions": (ended,)})
    page = write_page(run, replace(result, content=content), NOW).read_text(encoding="utf-8")
    assert re.search(told, page)
    unseen = "One camera does not|Nothing in the picture|The final picture shows"
    assert not re.search(f"Not shown|Not counted|{unseen}", page.partition("All results")[0])


def test_the_view_shows_the_insertion_too() -> None:
    """The rerun file of an insertion also holds paths, plans and curves of the estimate."""
    analyse_recorded()
    run = open_run(record_insertion().path)
    plain = read_view(write_view(run, {}, NO_VIEW, describe_statusword))
    assert not {"/nis/NIS", "/camera/plan"} & plain.keys()
    shown = read_view(write_view(run, {}, make_run_view(run), describe_statusword))
    assert {"/nis/NIS", "/camera/plan", "/camera/target", "/depth/needle"} <= shown.keys()
    assert shown["/nis/95 % below"][0] == pytest.approx(chi2.ppf(0.95, 2), abs=0.01)
    followed = read_view(write_view(run, {}, follow_run(run), describe_statusword))
    assert followed["/nis/NIS"] == pytest.approx(shown["/nis/NIS"])


def test_without_a_path_the_page_says_what_to_do() -> None:
    """The reason, by how much to move the target, and what decides; no part is empty."""
    run = record_insertion("target.position_mm=[0,20,10]")
    result = analyze_run(run, find_run_experiment(run), workers=1, created=NOW, provenance=PROVENANCE)
    page = write_page(open_run(run.path), result, NOW).read_text(encoding="utf-8")
    told = r"The needle cannot be steered there: the target lies \d+\.\d\u00a0mm inside the turning"
    assert re.search(told, page)
    assert re.search(r"Move the target by <b>\d+\.\d\u00a0mm</b> or more", page)
    assert "there is no path:" not in page
    assert "On the way" not in page
    assert "The radius that decides" in page.partition("<h2>How sure")[2]
