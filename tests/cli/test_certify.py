"""`labrig campaign --certify`: a run is repeated virtually, and its certificate is written into it."""

import shutil
from pathlib import Path

import pytest

from labrig.record.check import check_run
from tests.cli.conftest import RIG, ROOT, Labrig, printed_json
from tests.record.faults import flip_bit

TINY = (
    "target.position_mm=[0,1,12]",
    "obstacles=[]",
    "insertion.max_length_mm=30",
    "insertion.speed_mm_s=2",
    "insertion.frame_every_mm=6",
    "policy.near_mm=0",
    "policy.final_mm=0",
    "roll_zero.rolls=4",
    "roll_zero.length_mm=12",
)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the shortest insertion, made by the command that people use."""
    settings = (word for setting in TINY for word in ("--set", setting))
    protocol, runs = ROOT / "protocols" / "insertion.yaml", tmp_path_factory.mktemp("runs")
    return Path(printed_json("run", protocol, "--rig", RIG, "--runs-dir", runs, "--json", *settings)["run"])


def test_a_run_gets_a_certificate_that_its_page_shows(made: Path, labrig: Labrig) -> None:
    """Every assumption is turned, the document is printed and sealed, and the page has it."""
    done = labrig("campaign", "--certify", made, "--repetitions", 2, "--json")
    assert done.exit_code == 0
    document = done.json()
    assert Path(document["certificate"]) == made / "certificate" / "001" / "certificate.json"
    assert (document["run"], document["repetitions"], document["base"]["n"]) == (made.name, 2, 2)
    names = {margin["name"] for margin in document["margins"]}
    assert {
        "radius of curvature",
        "roll zero",
        "play of the hinges",
        "target along the insertion (z)",
    } <= names
    tried = sum(value["arrivals"]["n"] for margin in document["margins"] for value in margin["tried"])
    assert document["insertions"] == tried + 2
    assert "virtual insertions in" in done.err
    page = Path(document["report"]).read_text(encoding="utf-8")
    assert "What would have to be wrong for this to miss</h2>" in page
    assert check_run(made).seal == "sealed"


def test_what_cannot_be_certified_is_refused_with_the_reason(
    made: Path, labrig: Labrig, tmp_path: Path
) -> None:
    """A sweep, a damaged run, a campaign file beside it, and repetitions without a run."""
    sweep = labrig("campaign", "--certify", ROOT / "tests" / "records" / "steerability")
    assert (sweep.exit_code, "has no assumptions" in sweep.err) == (2, True)
    damaged = Path(shutil.copytree(made, tmp_path / "damaged"))
    flip_bit(next(damaged.glob("frames/*.png")))
    refused = labrig("campaign", "--certify", damaged)
    assert (refused.exit_code, "is damaged" in refused.err, (damaged / "certificate/002").exists()) == (
        4,
        True,
        False,
    )
    both = labrig("campaign", ROOT / "protocols" / "campaign-replanning.yaml", "--certify", made)
    assert (both.exit_code, "--certify takes all from the run" in both.err) == (2, True)
    alone = labrig("campaign", "--repetitions", 3)
    assert (alone.exit_code, "goes with --certify" in alone.err) == (2, True)
