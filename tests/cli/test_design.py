"""`labrig design`: from a radius to a cut."""

import contextlib
import csv
import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from labrig.cli.finished_run import print_summary
from labrig.cli.main import run_command
from labrig.experiments.hinge_design.summary import summarise
from labrig.needle.tube import TABLE_1, Tube
from labrig.protocol.design_file import load_design
from tests.cli.conftest import Labrig, SweepRun


@dataclass(frozen=True)
class Designed:
    """What one whole design left behind."""

    document: dict[str, Any]
    figure: Path
    table: Path
    design: Path


@pytest.fixture(scope="module")
def designed(sweep: SweepRun, tmp_path_factory: pytest.TempPathFactory) -> Designed:
    """Return the paper's needle, with a sweep's measured radius, figure and table, on a coarse grid."""
    folder = tmp_path_factory.mktemp("a design, é")
    figure, table, design = folder / "figure 3.png", folder / "figure 3.csv", folder / "needle.json"
    printed = io.StringIO()
    command = [
        "design",
        "--json",
        "--from-run",
        sweep.run.name,
        "--runs-dir",
        str(sweep.run.parent),
        "--grid-points",
        "3",
        "--tip-length-mm",
        "40",
    ]
    with contextlib.redirect_stdout(printed):
        exit_code = run_command(
            [*command, "--figure", str(figure), "--csv", str(table), "--out", str(design)]
        )
    assert exit_code == 0
    return Designed(json.loads(printed.getvalue()), figure, table, design)


def test_the_papers_needle_is_the_default(designed: Designed) -> None:
    """Without options, equation (3) gives 4.12 degrees, next to table I's 4.13."""
    document = designed.document
    assert Tube(**document["tube"]) == TABLE_1.tube
    assert (document["radius_mm"], document["clearance_mm"]) == (pytest.approx(30.0), 0.025)
    assert document["beta_rot_deg"] == pytest.approx(11.46, abs=0.005)
    assert document["beta_cut_deg"] == pytest.approx(4.12, abs=0.005)
    assert document["table_1"] == {"beta_cut_deg": 4.13, "beta_rot_deg": 11.46}


def test_the_search_is_printed_next_to_the_equations(designed: Designed) -> None:
    """Our contour needs less inclination for the same rotation; its plane has an RMSE."""
    search = designed.document["search"]
    assert search["beta_rot_deg"] == pytest.approx(designed.document["beta_rot_deg"], abs=0.005)
    assert search["beta_cut_deg"] == pytest.approx(3.33, abs=0.02)
    assert set(search["fit"]) == {"a", "b", "c", "rmse_deg"}
    assert search["fit"]["a"] == pytest.approx(1.10, abs=0.01)
    assert search["grid"]["points"] == 3
    assert search["inside_grid"] is True


def test_a_sweep_gives_the_effective_clearance(designed: Designed, sweep: SweepRun) -> None:
    """Its mean radius gives a rotation and a clearance, by equation (3) and our contour."""
    measured = designed.document["measured"]
    assert measured["radius_mm"] == sweep.document["result"]["mean_radius_mm"]
    assert measured["beta_cut_deg"] == 4.13
    assert Path(measured["run"]) == sweep.run
    assert measured["beta_rot_deg"] == pytest.approx(343.77 / measured["radius_mm"], abs=0.01)
    assert measured["clearance_mm"] == pytest.approx(0.0283, abs=0.002)
    assert measured["search_clearance_mm"] > 0


def test_tolerances_and_links_are_reported(designed: Designed) -> None:
    """The laser's tolerance gives an interval of the radius, and the tip a number of links."""
    low, high = designed.document["tolerance"]["radius_mm"]
    assert low < 28 < 32 < high
    assert designed.document["links"] == 13


def test_the_table_holds_every_cell(designed: Designed) -> None:
    """The CSV has a line per cell, and the rotations of both hinges add up."""
    rows = list(csv.DictReader(designed.table.read_text(encoding="utf-8").splitlines()))
    assert len(rows) == 9
    for row in rows:
        both = float(row["beta_a_deg"]) + float(row["beta_b_deg"])
        assert float(row["beta_rot_deg"]) == pytest.approx(both, abs=2e-4)


def test_the_figure_is_a_picture(designed: Designed) -> None:
    """Its format is that of the file name."""
    assert designed.figure.read_bytes().startswith(b"\x89PNG")


def test_the_design_file_says_how_it_was_made(designed: Designed) -> None:
    """It has tube, cut, radius, worst cases, code version and command."""
    design = load_design(designed.design)
    assert Tube(**design.tube.model_dump()) == TABLE_1.tube
    assert (design.radius_mm, design.clearance_mm) == (30.0, 0.025)
    assert [design.radius_low_mm, design.radius_high_mm] == designed.document["tolerance"]["radius_mm"]
    assert {"labrig", "command_line", "packages"} <= set(design.provenance)


def test_the_text_has_both_answers(designed: Designed, capsys: pytest.CaptureFixture[str]) -> None:
    """It has both inclinations, table I, the measured needle and the limits of our contour."""
    print_summary(summarise(designed.document))
    text = capsys.readouterr().out
    for part in ("4.12", "3.33", "Table I prints 4.13", "13 links", "Measured", "not for cutting"):
        assert part in text


@pytest.mark.parametrize(
    ("arguments", "exit_code", "words"),
    [
        (["--clearance-mm", "30"], 2, "30 µm is 0.03 mm"),
        (["--clearance-mm", "0"], 2, "laser clearance is 0 mm"),
        (["--clearance-mm", "-0.025"], 2, "laser clearance is -0.025 mm"),
        (["--radius-mm", "0.03"], 2, "0.03 m is 30 mm"),
        (["--radius-mm", "7"], 2, "cuts the socket's lips through"),
        (["--radius-mm", "200"], 1, "no inclination gives"),
        (["--inner-diameter-mm", "1.3"], 2, "below the outer diameter"),
        (["--link-length-mm", "0.5"], 2, "at least 0.928 mm"),
        (["--clearance-tolerance-mm", "3"], 2, "3 µm is 0.003 mm"),
        (["--tip-length-mm", "4"], 2, "tip length is 4 mm"),
        (["--measured-radius-mm", "300"], 1, "no clearance gives"),
        (["--measured-radius-mm", "27.6", "--beta-cut-deg", "44"], 2, "cutting inclination is 44 degrees"),
        (["--beta-cut-deg", "4"], 2, "--measured-radius-mm"),
        (["--measured-radius-mm", "27.6", "--from-run", "somewhere"], 2, "give one of them"),
        (["--from-run", "nowhere"], 4, "nowhere"),
        (["--figure", "figure.bmp"], 2, ".png, .svg, .pdf"),
        (["--out", "no-such-folder/needle.json"], 2, "no-such-folder"),
        (["--csv", "no-such-folder/table.csv"], 2, "no-such-folder"),
    ],
)
def test_bad_input_is_refused_before_the_search(
    arguments: list[str], exit_code: int, words: str, labrig: Labrig
) -> None:
    """An impossible design is refused with the limit and a remedy."""
    done = labrig("design", *arguments)
    assert done.exit_code == exit_code
    assert words in done.err
    assert "Traceback" not in done.err
    assert "searching" not in done.err


@pytest.mark.parametrize("option", ["--out", "--figure", "--csv"])
def test_an_existing_file_is_refused(option: str, labrig: Labrig, tmp_path: Path) -> None:
    """A file that exists is not replaced without --force."""
    existing = tmp_path / "figure.svg"
    existing.write_text("mine")
    done = labrig("design", option, existing, "--json")
    assert done.exit_code == 2
    assert done.json()["error"]["type"] == "OutputExistsError"
    assert existing.read_text() == "mine"
