"""The protocols and the rig of virtual insertions in benchmarks."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from labrig.devices.rig_file import RigDescription, load_rig
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.protocol.load import load_protocol

ROOT = Path(__file__).parents[2]
PROTOCOL, RIG = ROOT / "protocols" / "insertion.yaml", ROOT / "calibration" / "rig-simulated.yaml"

_EVERY_20_MM = (
    "policy.deviation_mm=null",
    "policy.near_mm=0",
    "policy.final_mm=0",
    "policy.backlash_mm=0",
    "policy.closing_mm=0",
)
_PAPER = (
    "planner.method=paper",
    "estimator.method=paper",
    "estimator.radius_sd_mm=0",
    "estimator.cavity_every_mm=null",
)
POLICIES: Mapping[str, tuple[str, ...]] = {
    "default": (),
    "every 20 mm": _EVERY_20_MM,
    "paper": (*_EVERY_20_MM, *_PAPER),
}
"""Settings of protocols/insertion.yaml by the name of the policy."""


@cache
def read_policy(policy: str) -> InsertionProtocol:
    """Return protocols/insertion.yaml with a policy."""
    protocol: Any = load_protocol(PROTOCOL, PROTOCOL_MODELS, list(POLICIES[policy]))
    assert isinstance(protocol, InsertionProtocol)
    return protocol


@cache
def read_simulated_rig() -> RigDescription:
    """Return calibration/rig-simulated.yaml."""
    return load_rig(RIG)
