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
from tests.cli.conftest import RIG, Labrig

ARMS = {"vary": {"policy.replan_every_mm": [10, 40]}}
FAST = {
    "policy.deviation_mm": None, "policy.near_mm": 0, "policy.final_mm": 0, "obstacles": [],
    "target.position_mm": [0, 2, 20],
}  # fmt: skip
TINY = {
    **FAST, "target.position_mm": [0, 1, 12], "insertion.frame_every_mm": 6, "roll_zero.rolls": 5,
    "roll_zero.length_mm": 12,
}  # fmt: skip
"""The shortest insertion, for whole runs."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a campaign file with two arms."""
    folder = tmp_path_factory.mktemp("campaign")
    write_campaign(folder, **ARMS, set=FAST, repetitions=2)
    return folder


def test_a_campaign_prints_the_keys_that_others_rely_on_and_goes_on(labrig: Labrig, made: Path) -> None:
    """Arms with means and shares, for any number of workers; begun again with more repetitions, it keeps its rows."""
    file = ("campaign", made / "campaign-tried.yaml", "--set", f"rig={RIG}")
    command = (*file, "--out", made / "out", "--workers", 2, "--json")
    done = labrig(*command)
    assert done.exit_code == 0, done.err
    document = done.json()
    assert (document["tasks"], document["done"], document["failed"]) == (4, 4, 0)
    assert document["campaign"] == str(made / "out")
    first = document["arms"][0]
    assert (first["name"], first["n"]) == ("replan_every_mm=10", 2)
    assert first["ci95_mm"][0] < first["mean_error_mm"] < first["ci95_mm"][1]
    assert Path(document["report"]).read_text(encoding="utf-8").startswith("<!doctype html>")
    before = pd.read_parquet(document["table"])
    errors_mm = before.loc[before["arm"] == first["name"], "true_target_error_mm"]
    assert first["mean_error_mm"] == pytest.approx(errors_mm.mean())
    assert first["within_tolerance"] == (errors_mm <= 2.0).sum()
    alone = labrig(*file, "--out", made / "alone", "--workers", 1, "--json").json()
    pd.testing.assert_frame_equal(before, pd.read_parquet(alone["table"]))  # workers change nothing
    write_campaign(made, **ARMS, set=FAST, repetitions=3)
    again = labrig(*command)
    assert "4 of 6 tasks are done" in again.err
    assert again.json()["done"] == 6
    pd.testing.assert_frame_equal(before, pd.read_parquet(document["table"]).head(4))


def test_whole_runs_on_a_simulated_rig_make_a_campaign_too(labrig: Labrig, tmp_path: Path) -> None:
    """Of any experiment: here a sweep with one insertion; its quantities are those of its result."""
    sweep = {
        "specimens": [{"name": "gel", "gelatin_percent": 13}], "insertions_per_specimen": 1,
        "insertion.length_mm": 22, "insertion.speed_mm_s": 5, "insertion.frame_every_mm": 20,
    }  # fmt: skip
    file = write_campaign(tmp_path, base=str(PROTOCOLS / "steerability.yaml"), depth="rig", set=sweep)
    done = labrig("campaign", file, "--set", f"rig={RIG}", "--out", tmp_path / "out", "--json")
    assert done.exit_code == 0, done.err
    document = done.json()
    assert document["measure"] == "mean_radius_mm"
    assert 25 < document["arms"][0]["mean"] < 32


def test_ctrl_c_ends_a_campaign_with_a_page_of_what_is_done(tmp_path: Path) -> None:
    """It goes on when it is started again."""
    file, out = write_campaign(tmp_path, set=FAST, repetitions=500), tmp_path / "out"
    options = map(str, ("campaign", file, "--set", f"rig={RIG}", "--out", out, "--workers", 1))
    with subprocess.Popen(
        [sys.executable, "-m", "labrig", *options], stderr=subprocess.PIPE, text=True
    ) as process:
        rows = out / "tasks.jsonl"
        while not (rows.exists() and rows.read_bytes().count(b"\n") > 1):  # the first is surely counted
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
