"""Keys that need pictures: what is said of them holds for a virtual insertion."""

import pytest

from labrig.campaign.campaign_file import needs_pictures
from labrig.devices.rig_file import load_rig
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.registry import find_experiment
from labrig.protocol.load import load_protocol
from labrig.runner.dry_run import simulate
from tests.campaign.campaigns import PROTOCOLS, RIGS

SHORT = ("target.position_mm=[0, 1, 30]", "obstacles=[]")


def values_of(rig_keys: tuple[str, ...] = ()) -> object:
    """Return what comes of a short virtual insertion with these overrides of the rig."""
    protocol = load_protocol(PROTOCOLS / "insertion.yaml", PROTOCOL_MODELS, SHORT)
    assert isinstance(protocol, InsertionProtocol)
    return simulate(
        find_experiment("insertion"), protocol, load_rig(RIGS / "rig-simulated.yaml", rig_keys), 5
    )


def test_a_virtual_insertion_is_the_same_whatever_only_pictures_need() -> None:
    """All of these changed at once."""
    changed = (
        "world.noise_sd=18",
        "world.blur_px=0.1",
        "world.light.level=90",
        "world.light.glint=0",
        "world.bubbles_per_specimen=0",
        "world.needle.bevel_deg=20",
        "world.needle.link_mm=5",
        "recording.fsync_period_s=2",
        "camera.exposure_us=4000",
    )
    assert all(needs_pictures(f"rig.{change.partition('=')[0]}") for change in changed)
    assert values_of(changed) == values_of()


@pytest.mark.parametrize(
    "change", ["world.needle.backlash_mm=3", "world.sheath.angle_play_sd_deg=3", "recording.state_rate_hz=3"]
)
def test_what_changes_a_virtual_insertion_may_be_varied(change: str) -> None:
    """Needle, sheath, and the rate at which a rig is looked at."""
    assert not needs_pictures(f"rig.{change.partition('=')[0]}")
    assert values_of((change,)) != values_of()
