"""The page of an insertion run: figure 9."""

import re
import shutil
from pathlib import Path

import pytest

from labrig.analysis.certificate import (
    Arrivals,
    Certificate,
    Margin,
    NotTriedPart,
    TriedValue,
    write_certificate,
)
from labrig.analysis.result import NO_LINES
from labrig.analysis.run import analyze_run
from labrig.devices.cia402_states import describe_statusword
from labrig.experiments.registry import find_run_experiment, follow_run, load_run_result, make_run_view
from labrig.record.reader import open_run
from labrig.report.rerun_view import write_view
from labrig.report.view import NO_VIEW
from tests.analysis.insertions import record_insertion
from tests.analysis.synthetic import NOW, PROVENANCE
from tests.pages import write_page
from tests.rerun_files import read_view


@pytest.fixture(scope="module")
def html() -> str:
    """Return the page of an insertion past one obstacle."""
    run = record_insertion()
    result = analyze_run(run, find_run_experiment(run), workers=1, created=NOW, provenance=PROVENANCE)
    return write_page(open_run(run.path), result, NOW).read_text(encoding="utf-8")


def test_each_replan_has_its_picture_with_everything_in_it(html: str) -> None:
    """Each picture shows depth, time, scale, plans, obstacle and target; the last one also path and truth."""
    plates = re.findall(r'<svg class="view"[^>]*><g .*?</svg>', html, re.DOTALL)
    assert len(plates) >= 3
    for plate in plates:
        assert plate.count('class="obstacle"') == 1
        assert plate.count('class="target"') == 2
        assert 'class="bar"' in plate
        assert re.search(r"\d+\.\d mm, \d+ s</text>", plate)
    assert all('class="plan"' in plate for plate in plates[:-1])
    assert 'class="former"' in plates[-2]
    assert 'class="taken"' in plates[-1]
    assert 'class="true"' in plates[-1]


def test_origin_and_direction_are_drawn_as_found_beside_the_command(html: str) -> None:
    """The enlarged sheath has a labelled arrow for found and commanded pose; their distance is in text and table."""
    (cut,) = re.findall(r'<svg class="view cut"[^>]*><g .*?</svg>', html, re.DOTALL)
    for kind in ("found", "commanded"):
        assert f'<line class="{kind}"' in cut
    assert ">found</text>" in cut
    assert ">command</text>" in cut
    assert re.search(
        r"<b>Trial 0</b>: [+−]0\.\d\d mm along, [+−]0\.\d\d mm across, [+−]\d\.\d\d degrees", html
    )
    assert "origins.csv" in html
    assert "planned from where the sheath was found" in html
    assert "the first plan" not in html


def test_error_clearance_nis_and_heading_are_drawn_over_the_length(html: str) -> None:
    """The page has the four curves, with the truth of a simulated rig."""
    for words in ("error of the estimate", "Clearance", "NIS", "Heading", "truth"):
        assert words in html


def test_the_page_says_how_near_and_by_what_it_was_measured(html: str) -> None:
    """The verdict states the measured and the true error."""
    assert "1 of 1 insertion reached the target" in html
    assert "Measured by the shaft" in html
    assert re.search(r"from it \(standard deviation 0\.\d\d mm\)", html)
    assert "true error" in html


def test_the_page_says_what_one_camera_does_not_see(html: str) -> None:
    """The page states the interval in space with its sources, and bounds the claim by them."""
    assert re.search(r"in space, it ended between 0\.\d\d and 0\.\d\d mm from the target", html)
    assert "<h2>In space</h2>" in html
    for source in ("Roll zero", "Lag of the bevel", "Wandering", "Start", "In the plane"):
        assert f">{source}<" in html
    assert "as far as the protocol's standard deviations are true" in html


def test_the_view_shows_the_insertion_too() -> None:
    """The rerun file of an insertion also holds paths, plans and curves of the estimate."""
    run = record_insertion()
    analyze_run(run, find_run_experiment(run), workers=1, created=NOW, provenance=PROVENANCE)
    assert (
        not {"/nis/NIS", "/camera/plan"}
        & read_view(write_view(run, NO_LINES, NO_VIEW, describe_statusword)).keys()
    )
    shown = read_view(write_view(run, NO_LINES, make_run_view(run), describe_statusword))
    assert {"/nis/NIS", "/camera/plan", "/camera/target", "/depth/needle"} <= shown.keys()
    followed = read_view(write_view(run, NO_LINES, follow_run(run), describe_statusword))
    assert followed["/nis/NIS"] == pytest.approx(shown["/nis/NIS"])


def test_what_a_person_wrote_stays_text(html: str) -> None:
    """Markup in a title is escaped."""
    assert "To &lt;b&gt;there&lt;/b&gt;" in html
    assert "<b>there" not in html


def test_a_certificate_is_shown_with_its_date_and_as_virtual(html: str, tmp_path: Path) -> None:
    """Without one the page names the command; with one it has table and bars, and text stays text."""
    assert "labrig campaign --certify" in html
    assert "What would have to be wrong for this to miss</h2>" not in html
    copied = Path(shutil.copytree(record_insertion().path, tmp_path / "copy"))
    write_certificate(open_run(copied), make_certificate())
    run = open_run(copied)
    page = write_page(run, load_run_result(run), NOW).read_text(encoding="utf-8")
    section = page[page.index("What would have to be wrong for this to miss</h2>") :]
    section = section[: section.index("<h2", 10)]
    assert "labrig campaign --certify" not in page
    for shown in (
        "2026-03-04 05:06:07 UTC",
        "Virtual: 123 insertions",
        "29 of 30",
        "&lt;b&gt;radius&lt;/b&gt;",
    ):
        assert shown in section
    assert "<b>radius" not in page
    rows = re.findall(r"<tr><td class=.name.*?</tr>", section, re.DOTALL)
    assert [("−1.5" in row, "&gt; 40" in row, "target missed" in row) for row in rows] == [
        (True, False, True),
        (False, True, False),
    ]
    (figure,) = re.findall(r"<svg.*?</svg>", section, re.DOTALL)
    assert "radius" in figure


def make_certificate() -> Certificate:
    """Return a certificate of two margins, one of them without end."""
    few = Arrivals(n=30, arrived=14, share_ci95=(0.3, 0.64))
    missed = TriedValue(value=-1.5, arrivals=few, ends={"target_missed": 16})
    margin = Margin(
        name="<b>radius</b>", unit="mm", key="world.gels", direction=-1, stated=0.0, sd=0.5, misses_at=missed,
        half_between=(-1.0, None), arrives_to=-0.5, farthest=-1.5, at_sds=(missed,), tried=(missed,),
    )  # fmt: skip
    never = margin.model_copy(
        update={"name": "play", "direction": 1, "sd": None, "misses_at": None, "farthest": 40.0}
    )
    return Certificate(
        run="copy", experiment="insertion", created="2026-03-04T05:06:07+00:00", provenance={}, arrival="it arrives",
        notes=(), seed=1, repetitions=30, insertions=123, margins=(margin, never),
        base=Arrivals(n=30, arrived=29, share_ci95=(0.83, 0.99)),
        not_tried=(NotTriedPart(name="scale", why="it is <i>fixed</i>"),),
    )  # fmt: skip
