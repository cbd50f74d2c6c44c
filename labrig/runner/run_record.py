"""Opens the record of a run, with all that is known before anything moves."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from labrig.clock import Clock
from labrig.devices.rig_file import RigDescription
from labrig.protocol.sections import ExperimentProtocol
from labrig.protocol.yaml_file import dump_yaml
from labrig.record.provenance import collect_code_diff, collect_provenance
from labrig.record.writer import Recorder, create_under_free_name, opening_files
from labrig.runner.experiment import Experiment


@dataclass(frozen=True)
class RunOrder:
    """What to run, and where its record is kept.

    Attributes
    ----------
    experiment : Experiment
    protocol : ExperimentProtocol
    rig : RigDescription or None
        None for an experiment that moves none.
    runs_dir : Path
        Where the run's folder is made.
    run_name : str or None
        Its name; None: UTC time and experiment.
    command_line : tuple of str
        As in `sys.argv`.
    sources : Mapping
        The files that the run is made from, as its manifest has them.
    """

    experiment: Experiment
    protocol: ExperimentProtocol
    rig: RigDescription | None
    runs_dir: Path
    run_name: str | None
    command_line: tuple[str, ...]
    sources: Mapping[str, object]


def open_record(order: RunOrder, trials: int, clock: Clock, devices: Mapping[str, object]) -> Recorder:
    """Make the folder of a run and begin its record.

    Parameters
    ----------
    trials : int
        Trials by its plan.
    devices : Mapping
        What the devices say of themselves.

    Raises
    ------
    OutputExistsError, DiskError
        When it cannot be made.
    """
    started, rig = clock.utc(), order.rig
    manifest = {
        "experiment": order.protocol.experiment,
        "title": order.protocol.title,
        "operator": order.protocol.operator,
        "seed": order.protocol.seed,
        "started": started.isoformat(timespec="seconds"),
        "trials_planned": trials,
        "sources": dict(order.sources),
        "provenance": collect_provenance(order.command_line),
        "plugins": {
            plugin.title: plugin.origin
            for plugin in (order.experiment.plugin, *(() if rig is None else rig.plugins))
        },
        "protocol": order.protocol.model_dump(mode="json", exclude_none=True),
        "devices": devices,
    }
    files = opening_files(
        dump_yaml(order.protocol),
        None if rig is None else dump_yaml(rig),
        {} if rig is None else rig.calibration_files(),
        collect_code_diff(),
    )
    create = partial(Recorder.create, order.runs_dir, manifest=manifest, files=files)
    if rig is not None:
        create = partial(
            create,
            fsync_period_s=rig.recording.fsync_period_s,
            least_free_bytes=int(1e6 * rig.recording.least_free_mb),
            picture_store=rig.camera.store,
        )
    if order.run_name is not None:
        return create(order.run_name)
    return create_under_free_name(started, order.protocol.experiment, create)
