"""Arms, points and seeds follow from the number of a task."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.campaign.campaign_file import CampaignFile, Sample
from labrig.campaign.inputs import make_models
from labrig.campaign.sampling import find_point, find_task, list_arms, write_overrides
from labrig.campaign.tasks import CampaignTasks
from tests.campaign.campaigns import load, write_campaign


def campaign(**keys: object) -> CampaignFile:
    """Return a campaign with these keys."""
    return CampaignFile.model_validate({"campaign": "c", "base": "p.yaml", "seed": 5, **keys})


def test_arms_are_the_product_of_named_arms_and_varied_values() -> None:
    """In the order of the file; keys that end alike keep their whole names."""
    arms = list_arms(
        campaign(arms={"a": {"x.m": "paper"}, "b": {}}, vary={"p.sd_mm": (1, 2), "q.sd_mm": (None, 0.5)})
    )
    assert [arm.name for arm in arms][:3] == [
        "a, p.sd_mm=1, q.sd_mm=null", "a, p.sd_mm=1, q.sd_mm=0.5", "a, p.sd_mm=2, q.sd_mm=null"
    ]  # fmt: skip
    assert len(arms) == 8
    assert arms[0].settings == {"x.m": "paper", "p.sd_mm": 1, "q.sd_mm": None}
    assert [arm.name for arm in list_arms(campaign())] == ["base"]


@given(st.integers(1, 4), st.integers(1, 5), st.integers(1, 6))
def test_every_arm_meets_every_point_and_repetition_once_with_shared_seeds(
    arms: int, points: int, repetitions: int
) -> None:
    """The seed depends on point and repetition alone, and is another for each of them."""
    sample = Sample(method="latin-hypercube", n=points, keys={"a.b": (0.0, 1.0)})
    tried = campaign(vary={"c.d": tuple(range(arms))}, sample=sample, repetitions=repetitions)
    tasks = [find_task(tried, number) for number in range(arms * points * repetitions)]
    assert len({(task.arm, task.point, task.repetition) for task in tasks}) == len(tasks)
    seeds = {(task.point, task.repetition): set[int]() for task in tasks}
    for task in tasks:
        seeds[task.point, task.repetition].add(task.seed)
    assert all(len(shared) == 1 for shared in seeds.values())
    assert len({seed for shared in seeds.values() for seed in shared}) == len(seeds)


def test_arms_are_repeated_equally_often_at_any_time() -> None:
    """Give or take one."""
    tried = campaign(vary={"c.d": (1, 2, 3)}, repetitions=10)
    for done in range(31):
        made = [find_task(tried, number).arm for number in range(done)]
        counts = [made.count(arm) for arm in range(3)]
        assert max(counts) - min(counts) <= 1


@pytest.mark.parametrize("method", ["latin-hypercube", "sobol"])
def test_points_fill_each_range_evenly(method: str) -> None:
    """Each 32nd of each range has one of 32 points (a Sobol sequence too, by its first property)."""
    sample = {"method": method, "n": 32, "keys": {"a.b": (2.0, 4.0), "c.d": (-1.0, 1.0)}}
    tried = campaign(sample=sample)
    points = [find_point(tried, number) for number in range(32)]
    for key, low, width in (("a.b", 2.0, 2.0), ("c.d", -1.0, 2.0)):
        units = (np.array([float(str(point[key])) for point in points]) - low) / width
        assert sorted(np.floor(32 * units)) == list(range(32))
    assert points == [find_point(tried, number) for number in range(32)]
    assert points != [find_point(campaign(sample=sample, seed=6), number) for number in range(32)]


def test_an_override_keeps_the_type_of_its_value() -> None:
    """Text stays text even if it looks like a number."""
    settings = {"a.b": "16", "c.d": 16, "e.f": None, "g.h": True, "i.j": [1, "x"]}
    assert write_overrides(settings) == ('a.b="16"', "c.d=16", "e.f=null", "g.h=true", 'i.j=[1, "x"]')


def test_a_worker_gets_the_protocol_and_rig_that_labrig_run_would_read(tmp_path: Path) -> None:
    """With the values of arm and point, and the seed of the task."""
    keys = {
        "depth": "rig",
        "vary": {"policy.replan_every_mm": [5, 10]},
        "sample": {
            "method": "latin-hypercube",
            "n": 3,
            "keys": {"target.position_mm.1": [0, 8], "rig.world.needle.backlash_mm": [1, 2]},
        },
    }
    loaded = load(write_campaign(tmp_path, **keys))
    order = list(CampaignTasks(loaded).list_orders(0))[3]
    protocol, rig = make_models(order.inputs, order.settings, order.seed)
    point = find_point(loaded.file, 1)
    assert protocol.seed == find_task(loaded.file, 3).seed
    assert protocol.model_dump()["policy"]["replan_every_mm"] == 10
    assert protocol.model_dump()["target"]["position_mm"][1] == point["target.position_mm.1"]
    assert rig is not None
    assert rig.world is not None
    assert rig.world.needle.backlash_mm == point["rig.world.needle.backlash_mm"]
    assert rig.calibration_files()
