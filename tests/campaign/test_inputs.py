"""What the tasks of a campaign are made from, in workers that are elsewhere."""

import json
import shutil
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import pytest

from labrig.analysis.engine import open_process_pool, run_in_order
from labrig.campaign.inputs import ArmInputs, require_calibration
from labrig.campaign.tasks import CampaignTasks, compute_task
from labrig.errors import WorkersError
from tests.campaign.campaigns import RIGS, load, write_campaign


def test_a_worker_in_another_folder_finds_the_calibration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rig file that is named relative to the working folder is found by a worker that has another one."""
    shutil.copytree(RIGS, tmp_path / "calibration")
    monkeypatch.chdir(tmp_path)
    loaded = load(write_campaign(tmp_path), Path("calibration/rig-simulated.yaml"))
    assert str(loaded.rig) == "calibration/rig-simulated.yaml"
    (inputs,) = loaded.inputs
    assert {name for name, _ in inputs.calibration} >= {"intrinsics.json", "plane.json"}
    with ProcessPoolExecutor(1, get_context("spawn"), monkeypatch.chdir, ("/",)) as executor:
        executor.submit(require_calibration, inputs).result()


@pytest.mark.parametrize(
    ("change", "message"),
    [("change", "has another calibration file plane.json"), ("remove", "does not see the calibration file")],
)
def test_a_worker_with_another_calibration_ends_the_campaign(
    tmp_path: Path, change: str, message: str
) -> None:
    """No task is computed from another camera calibration than the one the campaign began with."""
    shutil.copytree(RIGS, tmp_path / "calibration")
    rig = tmp_path / "calibration" / "rig-simulated.yaml"
    loaded = load(write_campaign(tmp_path, repetitions=2), rig)
    plane = next(path for path in rig.parent.rglob("*.json") if "plane" in path.name)
    if change == "change":
        plane.write_text(json.dumps({**json.loads(plane.read_text()), "note": "another day"}))
    else:
        plane.unlink()
    tasks = CampaignTasks(loaded)
    with (
        open_process_pool(1, "computed tasks") as pool,
        pytest.raises(WorkersError, match=message),
    ):
        list(run_in_order(pool, compute_task, tasks.list_orders(0)))


def test_a_campaign_leaves_the_state_of_a_rig_and_its_person_alone(tmp_path: Path) -> None:
    """Virtual needles are forgotten, and nobody is asked: neither a state file nor a real clock of the rig counts."""
    shutil.copytree(RIGS, tmp_path / "calibration")
    rig = tmp_path / "calibration" / "rig-simulated.yaml"
    text = rig.read_text()
    rig.write_text(text.replace("state_file: null", "clock: real\nstate_file: state.json"))
    assert rig.read_text() != text
    (inputs,) = load(write_campaign(tmp_path), rig).inputs
    assert isinstance(inputs, ArmInputs)
    described = json.loads(inputs.rig or "")
    assert (described["state_file"], described["clock"]) == (None, None)
