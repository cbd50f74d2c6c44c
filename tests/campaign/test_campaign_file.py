"""The campaign file: what it refuses before anything is computed."""

from pathlib import Path

import pytest

from labrig.campaign.campaign_file import MOST_ARMS, campaign_schema, load_campaign_file
from labrig.errors import FileFormatError, InputError
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


def test_a_file_of_another_kind_is_named_and_the_largest_grid_is_taken(tmp_path: Path) -> None:
    """Instead of a list of missing keys; up to the limit."""
    for file, word in ((PROTOCOLS / "insertion.yaml", "protocol"), (RIGS / "rig-simulated.yaml", "rig file")):
        with pytest.raises(FileFormatError, match=f"this is a {word}, expected a campaign file"):
            load_campaign_file(file)
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
    assert str(path) in problem.where
    assert where in problem.where
    assert message in problem.message


def test_keys_of_pictures_and_whole_numbers_are_taken_where_they_count(tmp_path: Path) -> None:
    """At depth rig; a part of what is set; whole numbers; the size of the picture goes with the lens."""
    pictures = {"vary": {"rig.world.noise_sd": [1, 9]}, "set": {"repetitions": 3}, "depth": "rig"}
    assert len(load(write_campaign(tmp_path, **pictures)).arms) == 2
    part = {"set": {"policy": {"near_mm": 1}}, "vary": {"policy.near_mm": [2, 3]}}
    assert len(load(write_campaign(tmp_path, **part)).arms) == 2
    lens = {"rig.camera.width_px": 1200, "rig.world.lens.width_px": 1200, "planner.max_arcs": 4}
    assert len(load(write_campaign(tmp_path, set=lens)).arms) == 1


def test_only_simulated_rigs_and_virtual_experiments_take_part(tmp_path: Path) -> None:
    """A campaign moves nothing real; the hint names the depth at which whole runs are made."""
    with pytest.raises(InputError, match="simulated rigs only"):
        load(write_campaign(tmp_path), RIGS / "rig-bench.yaml")
    path = write_campaign(tmp_path, base=str(PROTOCOLS / "roll-zero.yaml"), measure="sd_deg")
    with pytest.raises(InputError) as caught:
        load(path)
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
    committed = PROTOCOLS / "campaign.schema.json"
    assert committed.read_text(encoding="utf-8") == schema_text(campaign_schema())


@pytest.mark.parametrize("path", sorted(PROTOCOLS.glob("campaign-*.yaml")), ids=lambda path: path.stem)
def test_every_example_can_be_computed(path: Path) -> None:
    """All of its arms fit their protocol and rig, and its name is that of its file."""
    loaded = load(path, None)
    assert f"campaign-{loaded.file.campaign}" == path.stem
    assert loaded.by.quantity
