"""`labrig campaign`: what it prints, writes, goes on with and refuses."""

import json
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pandas as pd
import pytest

from tests.campaign.campaigns import PROTOCOLS, write_campaign
from tests.cli.conftest import RIG, ROOT, Labrig

ARMS = {"vary": {"policy.replan_every_mm": [10, 40]}}
FAST = {
    "policy.deviation_mm": None,
    "policy.near_mm": 0,
    "policy.final_mm": 0,
    "obstacles": [],
    "target.position_mm": [0, 2, 60],
}

TINY = {
    **FAST,
    "target.position_mm": [0, 1, 12],
    "insertion.frame_every_mm": 6,
    "roll_zero.rolls": 4,
    "roll_zero.length_mm": 12,
}
"""The shortest insertion, for whole runs."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a campaign file with two arms."""
    folder = tmp_path_factory.mktemp("campaign")
    write_campaign(folder, **ARMS, set=FAST, repetitions=2)
    return folder


def test_a_campaign_prints_the_keys_that_others_rely_on_and_goes_on(labrig: Labrig, made: Path) -> None:
    """Arms with their means and shares; a second start with more repetitions keeps the rows that are there."""
    command = (
        "campaign",
        made / "campaign-tried.yaml",
        "--set",
        f"rig={RIG}",
        "--out",
        made / "out",
        "--workers",
        2,
        "--json",
    )
    done = labrig(*command)
    assert done.exit_code == 0, done.err
    document = done.json()
    assert (document["tasks"], document["done"], document["failed"]) == (4, 4, 0)
    assert document["campaign"] == str(made / "out")
    first = document["arms"][0]
    assert first["name"] == "replan_every_mm=10"
    assert first["n"] == 2
    assert 0 < first["mean_error_mm"] < 30
    assert first["ci95_mm"][0] < first["mean_error_mm"] < first["ci95_mm"][1]
    assert first["within_tolerance"] in {0, 1, 2}
    assert Path(document["report"]).read_text(encoding="utf-8").startswith("<!doctype html>")
    before = pd.read_parquet(document["table"])
    write_campaign(made, **ARMS, set=FAST, repetitions=3)
    again = labrig(*command)
    assert "4 of 6 tasks are done" in again.err
    assert again.json()["done"] == 6
    pd.testing.assert_frame_equal(before, pd.read_parquet(document["table"]).head(4))


def test_a_campaign_that_goes_on_with_other_kernels_says_so(labrig: Labrig, tmp_path: Path) -> None:
    """One line of standard error names the kernels of the first rows, and those of now."""
    write_campaign(tmp_path, set=FAST, repetitions=1)
    command = ("campaign", tmp_path / "campaign-tried.yaml", "--set", f"rig={RIG}", "--out", tmp_path / "out")
    assert "note: the first rows" not in labrig(*command).err
    file = tmp_path / "out" / "campaign.json"
    document = json.loads(file.read_text(encoding="utf-8"))
    document["processor"]["libm"] = "glibc 2.1"
    file.write_text(json.dumps(document), encoding="utf-8")
    again = labrig(*command)
    assert again.exit_code == 0
    assert "note: the first rows were made with glibc 2.1, and this is glibc" in again.err


def test_the_order_of_workers_changes_nothing(labrig: Labrig, made: Path) -> None:
    """One process and three give the same rows."""
    tables = []
    for workers in (1, 3):
        out = made / f"by-{workers}"
        file = made / "campaign-tried.yaml"
        assert (
            labrig("campaign", file, "--set", f"rig={RIG}", "--out", out, "--workers", workers).exit_code == 0
        )
        tables.append(pd.read_parquet(out / "table.parquet"))
    pd.testing.assert_frame_equal(tables[0], tables[1])


def test_whole_runs_on_a_simulated_rig_make_a_campaign_too(labrig: Labrig, tmp_path: Path) -> None:
    """Of any experiment: here a sweep with one insertion; its quantities are those of its result."""
    sweep = {
        "specimens": [{"name": "gel", "gelatin_percent": 13}],
        "insertions_per_specimen": 1,
        "insertion.length_mm": 22,
        "insertion.speed_mm_s": 5,
        "insertion.frame_every_mm": 20,
    }
    file = write_campaign(tmp_path, base=str(PROTOCOLS / "steerability.yaml"), depth="rig", set=sweep)
    done = labrig("campaign", file, "--set", f"rig={RIG}", "--out", tmp_path / "out", "--json")
    assert done.exit_code == 0, done.err
    document = done.json()
    assert document["measure"] == "mean_radius_mm"
    assert 25 < document["arms"][0]["mean"] < 32


@pytest.mark.slow
def test_whole_insertions_give_a_table_like_that_of_virtual_ones(labrig: Labrig, tmp_path: Path) -> None:
    """With the same quantities of where the needle ended; what is counted by name is no column."""
    tables = []
    for depth in ("rig", "world"):
        file, out = write_campaign(tmp_path, **ARMS, depth=depth, set=TINY), tmp_path / depth
        done = labrig("campaign", file, "--set", f"rig={RIG}", "--out", out, "--workers", 2)
        assert done.exit_code == 0, done.err
        tables.append(pd.read_parquet(out / "table.parquet"))
    rig, world = tables
    assert len(rig) == len(world) == 2
    same = ["arm", "seed", "exit_status", "true_target_error_mm", "replans", "length_mm"]
    for table in tables:
        assert table[same].notna().all().all()
    assert rig["seed"].tolist() == world["seed"].tolist()
    assert "causes" not in rig


def test_ctrl_c_ends_a_campaign_with_a_page_of_what_is_done(tmp_path: Path) -> None:
    """It goes on when it is started again."""
    file, out = write_campaign(tmp_path, set=FAST, repetitions=100_000), tmp_path / "out"
    options = map(str, ("campaign", file, "--set", f"rig={RIG}", "--out", out, "--workers", 1))
    with subprocess.Popen(
        [sys.executable, "-m", "labrig", *options], stderr=subprocess.PIPE, text=True
    ) as process:
        rows = out / "tasks.jsonl"
        while not (rows.exists() and rows.stat().st_size):
            with suppress(subprocess.TimeoutExpired):
                assert process.wait(0.05) is None
        process.send_signal(signal.SIGINT)
        assert process.stderr is not None
        rest = process.stderr.read()
    assert process.returncode == 130, rest
    assert "Traceback" not in rest
    assert "the same command goes on behind them" in rest
    assert "not finished" in (out / "report.html").read_text(encoding="utf-8")
    assert f"report  {out / 'report.html'}" in rest


def test_a_campaign_that_its_rule_ended_has_nothing_left_to_do(labrig: Labrig, tmp_path: Path) -> None:
    """Started again, it computes nothing."""
    rule = {"ci95_width_mm": 100, "at_most": 200}
    arms = {"vary": {"tolerances.cut_deg": [0.1, 1]}, "measure": "reach_mm", "stop_when": rule}
    file = write_campaign(tmp_path, base=str(PROTOCOLS / "design.yaml"), **arms)
    command = ("campaign", file, "--workers", 1, "--out", tmp_path / "out", "--json")
    assert (labrig(*command).json()["ended"], labrig(*command).json()["done"]) == ("by_rule", 60)
    assert "has ended with 60 tasks; nothing is left to do" in labrig(*command).err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--workers", 2, "--cluster", "tcp://127.0.0.1:1"), "exclude each other"),
        (("--set", f"rig={ROOT}/calibration/rig-bench.yaml"), "simulated rigs only"),
    ],
)
def test_what_cannot_be_computed_is_refused(
    labrig: Labrig, made: Path, options: tuple[object, ...], message: str
) -> None:
    """Before a folder is made."""
    done = labrig("campaign", made / "campaign-tried.yaml", *options, "--out", made / "none")
    assert done.exit_code == 2
    assert message in done.err
    assert not (made / "none").exists()


def test_a_cluster_needs_its_extra(labrig: Labrig, made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without it the command ends with the page that says how to install it."""
    monkeypatch.setitem(sys.modules, "distributed", None)
    done = labrig(
        "campaign", made / "campaign-tried.yaml", "--cluster", "tcp://127.0.0.1:1", "--out", made / "none"
    )
    assert done.exit_code == 2
    assert "extra cluster" in done.err
    assert "labrig manual install" in done.err


EXAMPLES = {
    "campaign-assumptions": ("sample.n=2",),
    "campaign-camera": ("vary={rig.world.noise_sd: [18]}", f"set={json.dumps(TINY)}"),
    "campaign-policy": ("set={target.position_mm: [0, 0, 40], obstacles: []}",),
    "campaign-reach": ("sample.n=2",),
    "campaign-replanning": ("vary={policy.replan_every_mm: [10, 80]}", "stop_when=null"),
}
"""What each example needs to be computed in seconds, besides one repetition."""


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted(PROTOCOLS.glob("campaign-*.yaml")), ids=lambda path: path.stem)
def test_every_example_gives_a_table_and_a_page(labrig: Labrig, tmp_path: Path, path: Path) -> None:
    """Shortened to a few tasks, none of which fails."""
    changes = (word for change in ("repetitions=1", *EXAMPLES[path.stem]) for word in ("--set", change))
    done = labrig("campaign", path, *changes, "--workers", 1, "--out", tmp_path / "out", "--json")
    assert done.exit_code == 0, done.err
    document = done.json()
    assert (document["done"], document["failed"], document["ended"]) == (document["tasks"], 0, "complete")
    assert len(pd.read_parquet(tmp_path / "out" / "table.parquet")) == document["tasks"] > 0
    assert Path(document["report"]).is_file()


def test_a_campaign_needs_a_name(labrig: Labrig) -> None:
    """Of an unknown name the nearest campaign is named."""
    assert "Missing argument 'FILE'" in labrig("campaign").err
    assert "there is no campaign campaign-x" in labrig("campaign", "campaign-x").err
    assert "did you mean campaign-reach?" in labrig("campaign", "reach").err
