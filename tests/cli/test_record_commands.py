"""Commands that read runs: list, reanalyze, report, import, view."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from labrig.errors import InputError
from labrig.library.door import write_report
from tests.cli.conftest import ROOT, Labrig, SweepRun

REAL = ROOT.parent / "shared" / "data" / "real_insertions"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


def test_a_folder_without_runs_says_how_to_make_one(labrig: Labrig, tmp_path: Path) -> None:
    """A folder without runs gives an empty list and names the command that makes the first run."""
    done = labrig("runs", "--runs-dir", tmp_path)
    assert done.exit_code == 0
    assert "labrig run" in done.err


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


def test_runs_to_reanalyze_are_named_or_chosen(labrig: Labrig, tmp_path: Path) -> None:
    """Neither runs nor a condition, or both, is refused, as is a condition that no run fits."""
    shutil.copytree(ROOT / "tests" / "records" / "steerability", tmp_path / "one")
    here = ("--runs-dir", tmp_path)
    for wrong in ((), (tmp_path / "one", "--where", "tag=pilot"), ("--where", "needle=none")):
        done = labrig("reanalyze", *wrong, *here)
        assert done.exit_code == 2
        assert not (tmp_path / "one" / "analysis" / "002").exists()


@pytest.mark.parametrize("setting", ["analyis.window_start_mm=5", "analysis.window_strt_mm=5"])
def test_a_setting_with_a_slip_is_refused_with_the_nearest(
    labrig: Labrig, tmp_path: Path, setting: str
) -> None:
    """A misspelt section or key is refused with a suggestion, and no result is made."""
    run = shutil.copytree(ROOT / "tests" / "records" / "steerability", tmp_path / "run")
    done = labrig("reanalyze", run, "--set", setting)
    assert done.exit_code == 2
    assert "did you mean analysis" in done.err or "did you mean window_start_mm" in done.err
    assert [path.name for path in (run / "analysis").iterdir()] == ["001"]


def test_a_page_needs_no_network_and_is_written_again(
    labrig: Labrig, sweep: SweepRun, tmp_path: Path
) -> None:
    """`labrig report` writes the page again, and the page fetches nothing from a network."""
    run = shutil.copytree(sweep.run, tmp_path / "copy")
    (run / "report.html").unlink()
    (row,) = labrig("report", run, "--json").json()
    page = Path(row["report"]).read_text(encoding="utf-8")
    assert re.findall(r"""(?:src|href)=["'](?:https?:)?//[^"']*""", page) == []
    assert "27.6" in page


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


@pytest.mark.skipif(not REAL.is_dir(), reason="../shared/data/real_insertions is not here")
def test_real_insertions_become_runs_that_are_measured(labrig: Labrig, tmp_path: Path) -> None:
    """A folder of real pictures is imported and measured: tips are found, and no radius is stated."""
    folder = tmp_path / "pictures"
    folder.mkdir()
    for picture in sorted((REAL / "DC_0_feedbackfinal_alvo1").iterdir())[::3]:
        shutil.copy(picture, folder)
    (imported,) = labrig(
        "import", folder, "--px-per-mm", 5.607, "--origin-px", 70, 50, "--insertion", "down", "--needle-diameter-mm", 1,
        "--runs-dir", tmp_path / "runs", "--json",
    ).json()  # fmt: skip
    assert imported["ok"] is True
    done = labrig("reanalyze", imported["run"], "--set", "analysis.roll_sd_deg=3", "--json")
    assert done.exit_code == 0
    import json

    result = json.loads((Path(done.json()[0]["analysis"]) / "result.json").read_text())
    assert result["settings"]["roll_sd_deg"] == 3.0
    assert result["not_in_interval"][:3] == ["lens", "plane", "surface"]
    assert len(result["measurements"]) == 6
    assert sum(measurement["found"] for measurement in result["measurements"]) >= 5
    assert not any(measurement["accepted"] for measurement in result["measurements"])


def test_a_folder_without_pictures_is_refused(labrig: Labrig, tmp_path: Path) -> None:
    """Importing an empty folder exits with 2 and names it."""
    done = labrig("import", tmp_path, "--px-per-mm", 5, "--origin-px", 0, 0, "--json")
    assert done.exit_code == 2
    assert str(tmp_path) in done.json()["error"]["message"]


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
