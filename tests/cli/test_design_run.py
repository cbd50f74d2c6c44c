"""`labrig run protocols/design.yaml`: a design as a run, without a rig, and what other runs take from it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from labrig.protocol.design_file import load_design
from labrig.record.reader import open_run
from tests.cli.conftest import RIG, ROOT, Labrig, printed_json
from tests.protocol.designs import sweep_with

DESIGN = ROOT / "protocols" / "design.yaml"
COARSE = ("--set", "grid_points=3")


@dataclass(frozen=True)
class Ran:
    """A design that was run once: its folder, and what `labrig run --json` printed."""

    run: Path
    document: dict[str, Any]

    @property
    def result(self) -> dict[str, Any]:
        """The design document."""
        found: dict[str, Any] = self.document["result"]
        return found

    @property
    def analysis(self) -> Path:
        """The folder of its first result."""
        return self.run / "analysis" / "001"


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    """Return the committed protocol on a coarse grid, run where the only rig file there could be is missing."""
    runs = tmp_path_factory.mktemp("top") / "runs"
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("LABRIG_RIG", str(runs / "no-such-rig.yaml"))
        document = printed_json("run", DESIGN, "--runs-dir", runs, "--run-name", "design", "--json", *COARSE)
    return Ran(Path(document["run"]), document)


def test_the_record_is_whole_and_has_no_rig(ran: Ran) -> None:
    """A closed run without rig.yaml, pictures or moves, with its protocol."""
    run = open_run(ran.run)
    assert run.damage == ()
    assert not (ran.run / "rig.yaml").exists()
    assert run.protocol["experiment"] == "design"
    assert list(run.events["kind"]) == ["run_start", "run_stop"]
    assert (len(run.pictures), run.devices) == (0, {})


def test_the_design_file_holds_the_answer(ran: Ran) -> None:
    """Radius, worst cases and the inclination of equation (3) can be read."""
    design = load_design(ran.analysis / "design.json")
    assert (design.radius_mm, design.tube.outer_diameter_mm, design.basis) == (30.0, 1.2, "equation (3)")
    assert design.beta_cut_deg == ran.result["beta_cut_deg"]
    tolerance = ran.result["tolerance"]
    assert (design.radius_low_mm, design.radius_high_mm) == (tolerance["low_mm"], tolerance["high_mm"])


def test_the_page_says_what_is_claimed(ran: Ran) -> None:
    """It has the figure, both answers, table I's value, and the limits of our contour."""
    page = Path(ran.document["report"]).read_text(encoding="utf-8")
    for part in ("Rotation of two adjacent hinges", "4.12", "4.13", "3.33", "27.60 to 32.86", "grid.csv", "design.json",
                 "does not reproduce the slope with the clearance", "no cutting file"):  # fmt: skip
        assert part in page
    assert "simulated rig" not in page


def test_a_radius_that_our_contour_cannot_give_has_equation_3s_answer(labrig: Labrig, tmp_path: Path) -> None:
    """For 45 mm at 0.025 mm the page has that answer and the reason."""
    done = labrig("run", DESIGN, "--runs-dir", tmp_path, "--json", *COARSE, "--set", "radius_mm=45")
    document = done.json()
    assert (done.exit_code, document["exit_status"]) == (0, "success")
    result = document["result"]
    assert result["beta_cut_deg"] == pytest.approx(0.62, abs=0.01)
    assert (result["search"]["beta_cut_deg"], result["search"]["tolerance"]) == (None, None)
    assert "on our contour no inclination gives 7.639 degrees" in result["search"]["reason"]
    assert result["search"]["fit"]["b"] > 0
    page = Path(document["report"]).read_text(encoding="utf-8")
    assert page.count("on our contour no inclination gives") >= 2
    assert load_design(tmp_path / document["run"] / "analysis" / "001" / "design.json").radius_mm == 45.0


def test_a_tube_that_nothing_can_be_cut_from_is_a_no(labrig: Labrig, tmp_path: Path) -> None:
    """If only our contour applies and has no answer: exit code 1, a page, and no design file."""
    tube = "tube={outer_diameter_mm: 1.1, inner_diameter_mm: 0.6, link_length_mm: 3}"
    done = labrig(
        "run", DESIGN, "--runs-dir", tmp_path, "--json", *COARSE,
        "--set", tube, "--set", "radius_mm=45", "--set", "measured=null",
    )  # fmt: skip
    document = done.json()
    assert (done.exit_code, document["exit_status"], document["result"]["accepted"]) == (1, "success", False)
    assert "nothing to cut" in Path(document["report"]).read_text(encoding="utf-8")
    assert not (Path(document["run"]) / "analysis" / "001" / "design.json").exists()


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("clearance_mm=30", "less than or equal to 1"),
        ("clearance_mm=0", "greater than 0"),
        ("clearance_mm=0.3", "slip out of its socket"),
        ("clearance_mm=-0.025", "greater than 0"),
        ("radius_mm=7", "cuts the socket's lips through"),
        ("radius_mm=200", "no inclination gives"),
        ("tube.inner_diameter_mm=1.3", "must be below outer_diameter_mm, 1.2"),
        ("tube.inner_diameter_mm=0.05", "inner_diameter_mm is 0.05, must be greater than or equal to 0.1"),
        ("tube.link_length_mm=0.5", "at least 0.928 mm"),
        ("tolerances.clearance_mm=3", "less than or equal to 0.05"),
        ("tolerances={clearance_mm: 0.05, cut_deg: 10}", "might not turn at all"),
        ("measured.radius_mm=300", "no clearance gives"),
        ("measured.beta_cut_deg=44", "cutting inclination is 44 degrees"),
        ("grid_points=2", "grid_points is 2"),
    ],
)
def test_an_impossible_design_leaves_no_run(setting: str, words: str, labrig: Labrig, tmp_path: Path) -> None:
    """Values beyond a limit and mistaken units are refused at their key, with a hint."""
    done = labrig("run", DESIGN, "--runs-dir", tmp_path, "--set", setting)
    assert done.exit_code == 2
    assert words in done.err
    assert "hint:" in done.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("arguments", [("--rig", RIG), ("--set", "rig.world.noise_sd=0")])
def test_a_rig_for_a_design_is_a_mistake(
    arguments: tuple[object, ...], labrig: Labrig, tmp_path: Path
) -> None:
    """A named rig would not be used, and the error says so."""
    done = labrig("run", DESIGN, "--runs-dir", tmp_path, *arguments)
    assert done.exit_code == 2
    assert "moves no rig" in done.err


def test_a_sweep_takes_the_design_of_a_run(ran: Ran, labrig: Labrig, tmp_path: Path) -> None:
    """Its needle comes from design.json, and the world draws a radius within the tolerance."""
    top = ran.run.parent.parent
    sweep = sweep_with(top / "protocols", "  design_file: ../runs/design/analysis/001/design.json\n")
    shortened = (
        "--set",
        "insertions_per_specimen=1",
        "--set",
        "specimens=[{name: gel-10, gelatin_percent: 10}]",
    )
    quiet = ("--set", "rig.world.gels=[{gelatin_percent: 10, radius_mean_mm: 28.34, radius_sd_mm: 0}]")
    done = labrig("run", sweep, "--rig", RIG, "--runs-dir", tmp_path, "--json", *shortened, *quiet)
    assert done.exit_code == 0
    run = open_run(done.json()["run"])
    design = load_design(ran.analysis / "design.json")
    (drawn_mm,) = run.truth["radius_mm"]
    assert design.radius_low_mm < drawn_mm * 30 / 28.34 < design.radius_high_mm
    assert drawn_mm != 28.34
    protocol = run.protocol
    assert protocol["experiment"] == "steerability"
    assert protocol["needle"]["design_radius_mm"] == 30.0
    assert "within tolerance" in Path(done.json()["report"]).read_text(encoding="utf-8")
