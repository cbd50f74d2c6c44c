"""A labrig that puts a needle into gel, turning its bevel on the way, and is killed; arguments: RIG RUNS_DIR."""

import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

from labrig.devices.opening import Opening
from labrig.devices.operator import NO_OFFER, Answer, Offer, OperatorRequest
from labrig.devices.rig import open_rig
from labrig.devices.rig_file import load_rig
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.protocol.load import load_protocol
from labrig.protocol.yaml_file import dump_yaml
from labrig.record.events import TrialStart
from labrig.record.writer import Recorder, opening_files
from labrig.runner.session import Session

SWEEP = Path(__file__).parents[2] / "protocols" / "steerability.yaml"


class Willing:
    """Says yes to everything."""

    def ask(self, request: OperatorRequest, meanwhile: Callable[[], None], offer: Offer = NO_OFFER) -> Answer:
        """Answer."""
        return Answer(confirmed=True)


def main(rig_file: Path, runs_dir: Path) -> None:
    """Reference, insert, turn, insert, and die."""
    description = load_rig(rig_file)
    with open_rig(
        description, seed=0, person=Willing(), interrupted=lambda: None, opening=Opening(camera=False)
    ) as rig:
        rig.needle.mark_out()
        rig.reference_axes()
        manifest = {"experiment": "steerability", "started": rig.clock.utc()}
        protocol, text = dump_yaml(load_protocol(SWEEP, PROTOCOL_MODELS)), dump_yaml(description)
        recorder = Recorder.create(runs_dir, "crashed", manifest, opening_files(protocol, text))
        session = Session(rig, recorder, lambda _done, _doing: None)
        session.record(TrialStart(trial=0))
        rig.needle.mark_in_tissue(recorder.run_name)
        for axis, position, speed in (
            ("linear", 0.5, 5.0),
            ("insertion", 0.5, 5.0),
            ("rotation", 0.3, 1.0),
            ("insertion", 0.8, 5.0),
        ):
            session.move(axis, position, session.axis(axis).nearest_speed(speed))
        rig.axis("insertion").start_move(40.0, 1.0)
        rig.wait(0.3)
        os.kill(os.getpid(), signal.SIGKILL)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
