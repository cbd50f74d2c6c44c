"""Run a short experiment for each input line, in a forked process that another process kills.

Imports and the backdrop of the pictures take longer than the run. So this process makes a first run itself, in the
folder of its second argument, and forks the others; the first argument is a protocol of `SHORT`. Each returned call of
the recorder is acknowledged in a file beside the run, which survives a kill as the record does.
"""

import os
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labrig.devices.rig import open_rig
from labrig.devices.rig_file import RigDescription
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.registry import find_experiment
from labrig.protocol.load import load_protocol
from labrig.protocol.sections import ExperimentProtocol
from labrig.protocol.yaml_file import dump_yaml
from labrig.record.writer import Recorder, opening_files
from labrig.runner.conduct import conduct
from labrig.runner.session import Session
from tests.cli.example_runs import SHORTENED
from tests.devices.rigs import Person, simulated_rig

PROTOCOLS = Path(__file__).parents[2] / "protocols"
RUN, ACKNOWLEDGED, UNKILLED = "run", "acknowledged", "unkilled"

# A sweep of two insertions takes half a second.
SHORT: Mapping[str, tuple[str, ...]] = {
    "steerability": (
        "insertions_per_specimen=2",
        "specimens=[{name: gel, gelatin_percent: 13}]",
        "insertion.length_mm=26",
        "insertion.speed_mm_s=5",
        "insertion.frame_every_mm=26",
    ),
    **{name: SHORTENED[name] for name in ("insertion", "roll-zero", "calibration")},
}


def short_protocol(name: str) -> ExperimentProtocol:
    """Return a protocol that takes seconds at most."""
    return load_protocol(PROTOCOLS / f"{name}.yaml", PROTOCOL_MODELS, SHORT[name])


def rig() -> RigDescription:
    """Return the simulated rig on which it runs."""
    return simulated_rig()


class AcknowledgingRecorder(Recorder):
    """A recorder that writes into a file which calls have returned."""

    def acknowledge(self, stream: str) -> None:
        """Acknowledge a recorded line."""
        descriptor = os.open(self.path.parent / ACKNOWLEDGED, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
        os.write(descriptor, f"{stream}\n".encode())
        os.close(descriptor)

    def frame(self, image: NDArray[np.uint8], t_s: float, **fields: object) -> int:
        """Record and acknowledge."""
        number = super().frame(image, t_s, **fields)
        self.acknowledge("frames")
        return number

    def state(self, t_s: float, **fields: object) -> None:
        """Record and acknowledge."""
        super().state(t_s, **fields)
        self.acknowledge("states")

    def event(self, kind: str, t_s: float, **fields: object) -> None:
        """Record and acknowledge."""
        super().event(kind, t_s, **fields)
        self.acknowledge("events")


def never() -> str | None:
    """Return no signal, because SIGKILL cannot be caught."""
    return None


def run_once(name: str, folder: Path) -> None:
    """Run a short protocol from opening the rig to closing it."""
    protocol, description = short_protocol(name), rig()
    with open_rig(description, seed=protocol.seed, person=Person(), interrupted=never) as opened:
        recorder = AcknowledgingRecorder.create(
            folder,
            RUN,
            {
                "experiment": protocol.experiment,
                "started": opened.clock.utc(),
                "trials_planned": 2,
                "seed": protocol.seed,
                "devices": opened.describe(),
            },
            opening_files(dump_yaml(protocol), dump_yaml(description), description.calibration_files()),
        )
        conduct(
            find_experiment(protocol.experiment),
            protocol,
            Session(opened, recorder, lambda _done, _doing: None),
        )


def main() -> None:
    """Fork a run for each folder on standard input; print its process id, then its end."""
    name = sys.argv[1]
    run_once(name, Path(sys.argv[2]))
    print("ended", flush=True)
    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            run_once(name, Path(line.rstrip("\n")))
            os._exit(0)
        print(child, flush=True)
        os.waitpid(child, 0)
        print("ended", flush=True)


if __name__ == "__main__":
    main()
