"""The campaign file: what it refuses before anything is computed, and the tasks that follow from it."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.analysis.engine import open_process_pool, run_in_order
from labrig.campaign.campaign_file import (
    MOST_ARMS,
    CampaignFile,
    campaign_schema,
    load_campaign_file,
    needs_pictures,
)
from labrig.campaign.tasks import Arm, LoadedCampaign, compute_task, list_arms, make_models, write_overrides
from labrig.errors import FileFormatError, InputError, WorkersError
from labrig.protocol.schema import schema_text
from labrig.protocol.sections import Criterion
from tests.campaign.campaigns import PROTOCOLS, RIGS, load, write_campaign

GRID = {f"policy.{name}": list(range(1000)) for name in ("near_mm", "final_mm", "backlash_mm")}


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"vary": GRID}, "1000000000 arms"),
        ({"sample": {"method": "sobol", "n": 100, "keys": {"target.sd_mm": [0, 1]}}}, "no power of two"),
        ({"sample": {"method": "sobol", "n": 64, "keys": {"target.sd_mm": [1, 1]}}}, "the range is empty"),
        ({"vary": {"target.sd_mm": [0, 1]}, "set": {"target.sd_mm": 1}}, "target.sd_mm is in set too"),
        ({"repetitions": 9_000_000, "vary": {"target.sd_mm": [0, 1]}}, "18000000 tasks"),
        ({"repetitions": 40, "stop_when": {"ci95_width_mm": 0.1, "at_most": 39}}, "must be at least 40"),
        ({"stop_when": {"ci95_width_mm": 0.1, "at_most": 20}}, "must be at least 30"),
        ({"vary": {"policy.turning": ["20", 20]}}, "policy.turning has a value more than once"),
        ({"vary": {"seed": [1, 2]}}, "seed is drawn by the campaign"),
        ({"vary": {"rig.world.noise_sd": [1, 9]}}, "rig.world.noise_sd changes nothing at depth: world"),
        ({"set": {"rig.camera.exposure_us": 3}}, "rig.camera.exposure_us changes nothing at depth: world"),
        ({"campaign": "../elsewhere"}, "campaign"),
        ({"depth": "picture"}, "depth"),
    ],
)
def test_a_campaign_that_cannot_be_meant_is_refused(
    tmp_path: Path, keys: dict[str, object], message: str
) -> None:
    """Too large, empty, given twice, without effect, a rule that looks too early, a name that is a path."""
    with pytest.raises(FileFormatError) as caught:
        load_campaign_file(write_campaign(tmp_path, **keys))
    assert message in str(caught.value.problems)


def test_the_largest_grid_is_taken(tmp_path: Path) -> None:
    """Up to the limit."""
    path = write_campaign(tmp_path, vary={"policy.near_mm": list(range(MOST_ARMS))})
    assert load_campaign_file(path).round_tasks == MOST_ARMS


def sobol(key: str, low: float, high: float) -> dict[str, object]:
    """Return the keys of a campaign that samples one key."""
    return {"sample": {"method": "sobol", "n": 8, "keys": {key: [low, high]}}}


@pytest.mark.parametrize(
    ("keys", "where", "message"),
    [
        ({"vary": {"policy.replan_evry_mm": [5]}}, "replan_evry_mm", "unknown key"),
        ({"vary": {"policy.replan_every_mm": [5, -1]}}, "arm replan_every_mm=-1", "replan_every_mm"),
        ({"set": {"rig.world.noise": 1}}, "world.noise", "unknown key"),
        (sobol("target.sd_mm", -1, 1), "target.sd_mm", "-1"),
        (sobol("rig.world.noise", 0, 1), "world.noise", "unknown key"),
        (sobol("planner.max_arcs", 2, 8), "planner.max_arcs", "must be a valid integer"),
        ({"set": {"repetitions": 3}}, "arm base: repetitions", "makes 3 insertions"),
    ],
)
def test_a_key_or_value_that_the_base_protocol_does_not_take_is_refused_with_its_arm(
    tmp_path: Path, keys: dict[str, object], where: str, message: str
) -> None:
    """Before the first task, those at the ends of sampled ranges too."""
    path = write_campaign(tmp_path, **keys)
    with pytest.raises(FileFormatError) as caught:
        load(path)
    problem = caught.value.problems[0]
    assert (str(path) in problem.where, where in problem.where, message in problem.message) == (True,) * 3


def test_keys_of_pictures_and_whole_numbers_are_taken_where_they_count(tmp_path: Path) -> None:
    """At depth rig; a part of what is set; whole numbers; the size of the picture goes with the lens."""
    pictures = {"vary": {"rig.world.noise_sd": [1, 9]}, "set": {"repetitions": 3}, "depth": "rig"}
    assert len(load(write_campaign(tmp_path, **pictures)).arms) == 2
    part = {"set": {"policy": {"near_mm": 1}}, "vary": {"policy.near_mm": [2, 3]}}
    assert len(load(write_campaign(tmp_path, **part)).arms) == 2
    lens = {"rig.camera.width_px": 1200, "rig.world.lens.width_px": 1200, "planner.max_arcs": 4}
    assert len(load(write_campaign(tmp_path, set=lens)).arms) == 1


def test_an_experiment_that_is_not_virtual_is_refused(tmp_path: Path) -> None:
    """The hint names the depth at which whole runs are made."""
    with pytest.raises(InputError) as caught:
        load(write_campaign(tmp_path, base=str(PROTOCOLS / "roll-zero.yaml"), measure="sd_deg"))
    assert "depth: rig" in caught.value.hint


def test_the_measure_is_that_of_the_experiment_unless_the_campaign_names_another(tmp_path: Path) -> None:
    """With the tolerance of the protocol, which the campaign may replace; another measure has none by itself."""
    for keys, quantity, tolerance in (
        ({}, "true_target_error_mm", 2.0),
        ({"tolerance": 0.5}, "true_target_error_mm", 0.5),
        ({"measure": "replans"}, "replans", None),
    ):
        assert load(write_campaign(tmp_path, **keys)).by == Criterion(quantity, tolerance)


def test_the_committed_schema_is_the_models() -> None:
    """protocols/campaign.schema.json is what labrig init writes."""
    assert (PROTOCOLS / "campaign.schema.json").read_text(encoding="utf-8") == schema_text(campaign_schema())


@pytest.mark.parametrize("path", sorted(PROTOCOLS.glob("campaign-*.yaml")), ids=lambda path: path.stem)
def test_every_example_can_be_computed(path: Path) -> None:
    """All of its arms fit their protocol and rig, and its name is that of its file."""
    loaded = load(path, None)
    assert f"campaign-{loaded.file.campaign}" == path.stem
    assert loaded.by.quantity


def campaign(**keys: object) -> LoadedCampaign:
    """Return a campaign with these keys, whose arms have neither protocol nor rig."""
    file = CampaignFile.model_validate({"campaign": "c", "base": "p.yaml", "seed": 5, **keys})
    arms = tuple(Arm(name, values, cast("Any", None), None, {}) for name, values in list_arms(file).items())
    return LoadedCampaign(file, Path("p.yaml"), None, arms, Criterion("error_mm", None))


def test_arms_are_the_product_of_named_arms_and_varied_values() -> None:
    """In the order of the file; keys that end alike keep their whole names."""
    vary = {"p.sd_mm": (1, 2), "q.sd_mm": (None, 0.5)}
    arms = campaign(arms={"a": {"x.m": "paper"}, "b": {}}, vary=vary).arms
    assert [arm.name for arm in arms][:3] == [
        "a, p.sd_mm=1, q.sd_mm=null", "a, p.sd_mm=1, q.sd_mm=0.5", "a, p.sd_mm=2, q.sd_mm=null"
    ]  # fmt: skip
    assert len(arms) == 8
    assert arms[0].settings == {"x.m": "paper", "p.sd_mm": 1, "q.sd_mm": None}
    assert [arm.name for arm in campaign().arms] == ["base"]


@given(st.integers(1, 4), st.integers(1, 5), st.integers(1, 6))
def test_every_arm_meets_every_point_and_repetition_once_with_shared_seeds(
    arms: int, points: int, repetitions: int
) -> None:
    """The seed depends on point and repetition alone; at any time arms are repeated equally often, give or take one."""
    sample = {"method": "latin-hypercube", "n": points, "keys": {"a.b": (0.0, 1.0)}}
    tried = campaign(vary={"c.d": tuple(range(arms))}, sample=sample, repetitions=repetitions)
    tasks = list(tried.list_tasks())
    assert len({(task.arm.name, task.point, task.repetition) for task in tasks}) == len(tasks) == tried.count
    seeds = {(task.point, task.repetition): set[int]() for task in tasks}
    done = dict.fromkeys((arm.name for arm in tried.arms), 0)
    for task in tasks:
        seeds[task.point, task.repetition].add(task.seed)
        done[task.arm.name] += 1
        assert max(done.values()) - min(done.values()) <= 1
    assert all(len(shared) == 1 for shared in seeds.values())
    assert len({seed for shared in seeds.values() for seed in shared}) == len(seeds)


@pytest.mark.parametrize("method", ["latin-hypercube", "sobol"])
def test_points_fill_each_range_evenly(method: str) -> None:
    """Each 32nd of each range has one of 32 points (a Sobol sequence too, by its first property)."""
    sample = {"method": method, "n": 32, "keys": {"a.b": (2.0, 4.0), "c.d": (-1.0, 1.0)}}

    def draw(seed: int) -> list[dict[str, object]]:
        tried = campaign(sample=sample, seed=seed)
        return [tried.find_drawn(number) for number in range(32)]

    for key, low, width in (("a.b", 2.0, 2.0), ("c.d", -1.0, 2.0)):
        units = (np.array([float(str(point[key])) for point in draw(5)]) - low) / width
        assert sorted(np.floor(32 * units)) == list(range(32))
    assert draw(5) == draw(5) != draw(6)


def test_an_override_keeps_the_type_of_its_value() -> None:
    """Text stays text even if it looks like a number."""
    settings = {"a.b": "16", "c.d": 16, "e.f": None, "g.h": True, "i.j": [1, "x"]}
    assert write_overrides(settings) == ('a.b="16"', "c.d=16", "e.f=null", "g.h=true", 'i.j=[1, "x"]')


def test_a_worker_gets_the_protocol_and_rig_that_labrig_run_would_read(tmp_path: Path) -> None:
    """With the values of arm and point, and the seed of the task."""
    keys = {"target.position_mm.1": [0, 8], "rig.world.needle.backlash_mm": [1, 2]}
    sample = {"method": "latin-hypercube", "n": 3, "keys": keys}
    vary = {"policy.replan_every_mm": [5, 10]}
    task = load(write_campaign(tmp_path, depth="rig", vary=vary, sample=sample)).find_task(3)
    protocol, rig = make_models(task.arm, task.drawn, task.seed)
    values = protocol.model_dump()
    assert (task.point, protocol.seed, values["policy"]["replan_every_mm"]) == (1, task.seed, 10)
    assert values["target"]["position_mm"][1] == task.drawn["target.position_mm.1"]
    assert rig is not None
    assert rig.world is not None
    assert rig.world.needle.backlash_mm == task.drawn["rig.world.needle.backlash_mm"]
    assert rig.calibration_files()


def test_a_worker_in_another_folder_finds_the_calibration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the rig file is named relative to the working folder."""
    shutil.copytree(RIGS, tmp_path / "calibration")
    monkeypatch.chdir(tmp_path)
    loaded = load(write_campaign(tmp_path), Path("calibration/rig-simulated.yaml"))
    assert str(loaded.rig) == "calibration/rig-simulated.yaml"
    (arm,) = loaded.arms
    monkeypatch.chdir("/")
    assert arm.rig is not None
    assert {"intrinsics.json", "plane.json"} <= {*arm.calibration} == {*arm.rig.calibration_files()}


@pytest.mark.parametrize("spoil", [lambda file: file.write_text(f"{file.read_text()} "), Path.unlink])
def test_a_worker_with_another_calibration_ends_the_campaign(
    tmp_path: Path, spoil: Callable[[Path], object]
) -> None:
    """No task is computed from another camera calibration than the one the campaign began with."""
    shutil.copytree(RIGS, tmp_path / "calibration")
    loaded = load(write_campaign(tmp_path, repetitions=2), tmp_path / "calibration" / "rig-simulated.yaml")
    rig = loaded.arms[0].rig
    assert rig is not None
    spoil(rig.calibration_files()["plane.json"])
    with (
        open_process_pool(1, "computed tasks") as pool,
        pytest.raises(WorkersError, match="does not see the calibration files"),
    ):
        list(run_in_order(pool, compute_task, loaded.list_tasks()))


def test_a_campaign_leaves_the_state_of_a_rig_and_its_person_alone(tmp_path: Path) -> None:
    """Virtual needles are forgotten, and nobody is asked: neither a state file nor a real clock of the rig counts."""
    shutil.copytree(RIGS, tmp_path / "calibration")
    rig = tmp_path / "calibration" / "rig-simulated.yaml"
    text = rig.read_text()
    assert "state_file: null" in text
    rig.write_text(text.replace("state_file: null", "clock: real\nstate_file: state.json"))
    found = load(write_campaign(tmp_path), rig).arms[0].rig
    assert found is not None
    assert (found.state_file, found.clock) == (None, None)


SHORT = {"target.position_mm": [0, 1, 30], "obstacles": []}
OF_PICTURES: dict[str, object] = {
    "rig.world.noise_sd": 18, "rig.world.blur_px": 0.1, "rig.world.light.level": 90,
    "rig.world.light.glint": 0, "rig.world.bubbles_per_specimen": 0, "rig.world.needle.bevel_deg": 20,
    "rig.world.needle.link_mm": 5, "rig.recording.fsync_period_s": 2, "rig.camera.exposure_us": 4000,
}  # fmt: skip
COUNTED: dict[str, object] = {
    "rig.world.needle.backlash_mm": 3,
    "rig.world.sheath.angle_play_sd_deg": 3,
    "rig.recording.state_rate_hz": 3,
}


def test_what_is_said_of_keys_that_need_pictures_holds(tmp_path: Path) -> None:
    """A virtual insertion is the same whatever only pictures need, and another with each of the others."""
    (arm,) = load(write_campaign(tmp_path, set=SHORT)).arms

    def compute(**drawn: object) -> object:
        return compute_task(type(campaign().find_task(0))(0, arm, 0, drawn, 0, 5, "world"))

    assert all(map(needs_pictures, OF_PICTURES))
    assert not any(map(needs_pictures, (*COUNTED, "rig.camera.width_px")))
    plain = compute()
    assert compute(**OF_PICTURES) == plain
    assert all(compute(**{key: value}) != plain for key, value in COUNTED.items())
