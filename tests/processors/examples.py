"""A run of each example protocol, to be replayed in each environment: `python -m tests.processors.examples FOLDER`."""

import sys
from pathlib import Path

from labrig.devices.clocks import SimulatedClock
from labrig.experiments.declared import PROTOCOL_MODELS, find_experiment
from labrig.experiments.hinge_design.protocol import DesignProtocol
from labrig.protocol.load import load_protocol
from labrig.protocol.yaml_file import dump_yaml
from labrig.record.writer import Recorder, opening_files
from labrig.runner.conduct import conduct_without_rig
from tests.runner.sessions import PROTOCOLS, record_run

SHORTER = {
    "steerability": ("insertions_per_specimen=1", "specimens=[{name: gel-10, gelatin_percent: 10}]"),
    "calibration": ("views=4",),
    "roll-zero": (
        "roll_zero.length_mm=12",
        "roll_zero.torsion.depths_mm=[20, 26, 32]",
        "roll_zero.torsion.further_mm=10",
        "roll_zero.torsion.max_sd_deg=20",
    ),
    "insertion": (
        "target.position_mm=[0, 3, 40]",
        "obstacles=[]",
        "insertion.frame_every_mm=4",
        "roll_zero.rolls=4",
        "roll_zero.length_mm=12",
    ),
}
"""What makes long example protocols short enough for a test."""


def record_example(folder: Path, name: str) -> None:
    """Record a run of an example protocol, shortened; a design moves nothing and needs no rig."""
    protocol = load_protocol(PROTOCOLS / f"{name}.yaml", PROTOCOL_MODELS, SHORTER.get(name, ()))
    if isinstance(protocol, DesignProtocol):
        clock = SimulatedClock()
        manifest = {"experiment": "design", "started": clock.utc()}
        recorder = Recorder.create(folder, "run", manifest, opening_files(dump_yaml(protocol)))
        conduct_without_rig(find_experiment("design"), recorder, clock)
    else:
        record_run(folder, protocol)


if __name__ == "__main__":
    for path in sorted(PROTOCOLS.glob("*.yaml")):
        if not path.stem.startswith("campaign-"):
            record_example(Path(sys.argv[1]) / path.stem, path.stem)
