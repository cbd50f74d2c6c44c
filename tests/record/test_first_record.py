"""The first record, made by the first labrig and kept under data/: later ones go on opening it."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from labrig.analysis.run import analyze_run
from labrig.experiments.registry import find_run_experiment, load_run_result
from labrig.experiments.shared.curvature_result import CurvatureResult
from labrig.record.catalogue import list_runs
from labrig.record.check import check_run
from labrig.record.difference import compare_runs
from labrig.record.reader import open_run
from tests.analysis.synthetic import NOW, PROVENANCE
from tests.pages import write_page

ROOT = Path(__file__).parents[2]
FIRST = ROOT / "data" / "first-record"


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy that may be written into."""
    return Path(shutil.copytree(FIRST, tmp_path / "first-record"))


def test_it_opens_whole(copy: Path) -> None:
    """Nothing of it is missing or damaged; states, events, trials, pictures and truth can be read."""
    run = open_run(copy)
    assert (run.problems, check_run(copy).damage) == ((), ())
    assert run.manifest["schema_version"] == 1
    assert (len(run.states), len(run.events), len(run.trials), len(run.frames)) == (82, 18, 1, 3)
    assert [picture.shape for picture in run.frames] == [(212, 400)] * 3
    assert run.truth["radius_mm"][0] == pytest.approx(27.771, abs=0.001)
    assert len(list(run.can_frames)) > 1000


def test_its_first_result_reads_as_it_was_written(copy: Path) -> None:
    """The radius that the first labrig measured, with its interval."""
    result = load_run_result(open_run(copy))
    assert result is not None
    assert isinstance(result.content, CurvatureResult)
    (specimen,) = result.content.specimens
    assert specimen.mean_radius_mm == pytest.approx(27.77309197)


def test_it_is_measured_again(copy: Path) -> None:
    """Today's analysis measures its final picture to a tenth of a millimetre of what was drawn."""
    result = analyze_run(
        open_run(copy), find_run_experiment(open_run(copy)), workers=1, created=NOW, provenance=PROVENANCE
    )
    assert isinstance(result.content, CurvatureResult)
    assert result.content.parent == 1
    assert result.content.mean_radius_mm == pytest.approx(27.771, abs=0.1)


def test_its_report_is_written(copy: Path) -> None:
    """A page is made from it, with the radius."""
    run = open_run(copy)
    assert "27.7" in write_page(run, load_run_result(run), NOW).read_text(encoding="utf-8")


def test_it_is_listed_and_compared(copy: Path) -> None:
    """The catalogue knows it, and it does not differ from itself."""
    (summary,) = list_runs(copy.parent)
    assert (summary.protocol, summary.exit_status, summary.trials_done) == ("steerability", "success", 1)
    assert compare_runs(copy, FIRST) == ()


def test_it_says_where_it_comes_from() -> None:
    """Code, computer, devices with firmware before and after, calibration and seed are in its manifest."""
    manifest = json.loads((FIRST / "manifest.json").read_text(encoding="utf-8"))
    provenance, devices = manifest["provenance"], manifest["devices"]
    assert len(provenance["git_commit"]) == 40
    assert {"python", "platform", "host", "packages"} <= set(provenance)
    assert devices["axes"]["insertion"]["drive"]["software_version"] == 0x2110
    assert set(devices["snapshot"]["axes"]) == set(manifest["devices_after"]["axes"])
    assert set(manifest["hashes"]["calibration"]) == {"intrinsics.json", "plane.json"}
    assert manifest["seed"] == 20260


def test_it_is_small() -> None:
    """It takes less than 300 kB of the repository."""
    assert sum(path.stat().st_size for path in FIRST.rglob("*") if path.is_file()) < 300_000


def test_the_example_of_the_manual_runs_on_it(copy: Path) -> None:
    """The Python of the manual, word for word, reads it and draws a figure."""
    text = (ROOT / "labrig" / "manual" / "howto" / "export.md").read_text(encoding="utf-8")
    example = text[text.index("```python\n") + len("```python\n") :]
    (copy.parent / "data" / "runs").mkdir(parents=True)
    copy.rename(copy.parent / "data" / "runs" / "first")
    script = copy.parent / "example.py"
    script.write_text(example[: example.index("```")], encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-W", "error", script],
        cwd=copy.parent, check=True, capture_output=True, text=True, timeout=120, env={"MPLBACKEND": "agg", "PATH": ""},
    )  # fmt: skip
    assert "the needle advanced for" in done.stdout
    assert "27.77" in done.stdout
    assert (copy.parent / "first.png").stat().st_size > 10_000
