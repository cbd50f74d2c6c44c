"""What is computed in each environment: `python -m tests.processors.probes FILE EXAMPLES` writes it as JSON.

`python -m tests.processors.probes EXAMPLES` records the example protocols, which every environment replays.
"""

import json
import shutil
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from labrig.analysis.run import analyze_run
from labrig.campaign.tasks import compute_task
from labrig.devices.clocks import SimulatedClock
from labrig.experiments.declared import PROTOCOL_MODELS, find_experiment
from labrig.experiments.hinge_design.protocol import DesignProtocol
from labrig.experiments.registry import find_run_experiment, load_run_protocol
from labrig.protocol.load import load_protocol
from labrig.protocol.yaml_file import dump_yaml
from labrig.record.provenance import describe_processor
from labrig.record.reader import open_run
from labrig.record.writer import Recorder, opening_files
from labrig.runner.conduct import conduct_without_rig
from labrig.runner.replay import replay_run
from tests.analysis.synthetic import NOW, PROVENANCE
from tests.campaign.campaigns import RIGS, load, write_campaign
from tests.runner.sessions import PROTOCOLS, record_run

RECORDS = sorted(path for path in (Path(__file__).parents[1] / "records").iterdir() if path.is_dir())
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
        "target.position_mm=[0, 3, 40]", "obstacles=[]", "insertion.frame_every_mm=4", "roll_zero.rolls=5",
        "roll_zero.length_mm=12",
    ),
}  # fmt: skip
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


def compute_results() -> Iterator[tuple[str, object]]:
    """Yield the result of each kept record, and virtual insertions: of the example, and shorter ones in hard gel."""
    with tempfile.TemporaryDirectory() as folder:
        for record in RECORDS:
            run = open_run(Path(shutil.copytree(record, Path(folder) / record.name)))
            found = analyze_run(run, find_run_experiment(run), created=NOW, provenance=PROVENANCE)
            yield f"record {record.name}", found.document
        short = {"target.position_mm": [0, 6, 60], "obstacles": []}
        for rig, settings in (("rig-reference", {}), ("rig-hard", short)):
            file = write_campaign(Path(folder), repetitions=6, depth="world", set=settings)
            for task in load(file, RIGS / f"{rig}.yaml").list_tasks():
                yield f"insertion {task.number} on {rig}", asdict(compute_task(task))


def replay_records(examples: Path) -> Iterator[tuple[str, str]]:
    """Yield the verdict on each kept record that a procedure made, and on each example protocol."""
    kept = {f"replay {path.name}": path for path in RECORDS if path.name != "import"}
    for name, path in (
        kept.items() | {f"example {path.name}": path / "run" for path in examples.iterdir()}.items()
    ):
        run = open_run(path)
        found = replay_run(run, find_run_experiment(run), load_run_protocol(run), lambda _done, _doing: None)
        first = found.first_difference
        yield name, found.verdict if first is None else f"{found.verdict}: {first.path}"


if __name__ == "__main__":
    *out, examples_dir = map(Path, sys.argv[1:])
    if out:
        told = {"processor": describe_processor(), "replays": dict(replay_records(examples_dir))}
        out[0].write_text(json.dumps({**told, "results": dict(compute_results())}), encoding="utf-8")
    else:
        for each in sorted(PROTOCOLS.glob("*.yaml")):
            if not each.stem.startswith("campaign-"):
                record_example(examples_dir / each.stem, each.stem)
