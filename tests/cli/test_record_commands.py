"""Commands that read runs: list, reanalyze, report, import, view."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from labrig.errors import InputError
from labrig.library.door import write_report
from tests.cli.conftest import ROOT, Labrig, SweepRun

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


def test_several_runs_are_reanalyzed_at_once(labrig: Labrig, tmp_path: Path) -> None:
    """Unchanged settings give identical numbers; changed ones name the first picture that differs in each run."""
    first = ROOT / "tests" / "records" / "steerability"
    runs = [shutil.copytree(first, tmp_path / name) for name in ("one", "two")]
    rows = labrig("reanalyze", *runs, "--set", "analysis.window_start_mm=5", "--json").json()
    assert [(row["run"], row["ok"], row["parent"]) for row in rows] == [(str(run), True, 1) for run in runs]
    assert len({row["first_difference"]["frame"] for row in rows}) == 1
    own = labrig("reanalyze", *runs, "--json").json()
    assert [(row["parent"], Path(row["analysis"]).name) for row in own] == [(1, "003"), (1, "003")]
    again = labrig("reanalyze", *runs, "--json").json()
    assert [(row["parent"], row["first_difference"]) for row in again] == [(3, None), (3, None)]
    printed = labrig("reanalyze", *runs, "--set", "analysis.window_start_mm=3").out
    assert len(re.findall(r"first in frame \d+: measurements\.0\.", printed)) == 2
    assert "old: analysis/004, the run's own settings" in printed
    assert "new: analysis/005, analysis.window_start_mm=3" in printed


def test_the_runs_that_fit_a_condition_are_reanalyzed(labrig: Labrig, tmp_path: Path) -> None:
    """`--where` chooses as `labrig runs --where` does, from the folder of runs that is named; results are the same."""
    for name in ("one", "two", "other"):
        shutil.copytree(ROOT / "tests" / "records" / "steerability", tmp_path / name)
    for name in ("one", "two"):
        labrig("runs", "annotate", tmp_path / name, "--tag", "pilot")
    where = ("--where", "tag=pilot", "--runs-dir", tmp_path)
    rows = labrig("reanalyze", *where, "--workers", "1", "--json").json()
    assert {Path(row["run"]).name for row in rows} == {"one", "two"}
    assert {row["first_difference"] for row in labrig("reanalyze", *where, "--json").json()} == {None}
    assert not (tmp_path / "other" / "analysis" / "002").exists()


@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed, so the page is not opened")
def test_a_browser_shows_the_page_without_an_error(sweep: SweepRun, tmp_path: Path) -> None:
    """Headless Chromium loads the report with its figures without an error."""
    picture = tmp_path / "page.png"
    command = [
        str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
        "--disable-background-networking", "--disable-component-update", "--disable-sync",
        f"--user-data-dir={tmp_path / 'profile'}", f"--screenshot={picture}", "--window-size=1200,3000",
        (sweep.run / "report.html").as_uri(),
    ]  # fmt: skip
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    assert picture.stat().st_size > 50_000


def test_the_headline_names_a_result_that_was_chosen_or_has_other_settings(
    labrig: Labrig, tmp_path: Path
) -> None:
    """A notebook shows another one; a verdict against the run changes the badge; an unknown number is wrong."""
    run = shutil.copytree(ROOT / "tests" / "records" / "import", tmp_path / "import")
    labrig("reanalyze", run, "--set", "analysis.window_start_mm=5")
    labrig("runs", "annotate", run, "--verdict", "doubtful")
    headers = []
    for result in (None, 1):
        write_report(run, result=result)
        headers.append((run / "report.html").read_text(encoding="utf-8").split("</header>")[0])
    assert (
        "Result 2 was measured with settings changed after the run: analysis.window_start_mm=5." in headers[0]
    )
    assert '<span class="pill doubtful">complete, judged doubtful</span>' in headers[0]
    assert "Result 1 is shown; the newest is 2." in headers[1]
    assert "settings changed" not in headers[1]
    with pytest.raises(InputError):
        write_report(run, result=9)
