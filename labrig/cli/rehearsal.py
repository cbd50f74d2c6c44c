"""Serves a whole simulated rig for a rehearsal of the bench."""

import sys
from pathlib import Path

from labrig.cli.options import SIMULATED_RIG
from labrig.cli.output import print_json, print_line, say, say_wrapped
from labrig.cli.signals import note_signals
from labrig.cli.typed_lines import TypedLines
from labrig.devices.fault_script import load_faults
from labrig.devices.rig_file import RigDescription, load_rig
from labrig.devices.simulated.served_rig import Rehearsal, serve_rig
from labrig.devices.simulated.typed_requests import HELP
from labrig.errors import InputError
from labrig.simulation.description import WorldDescription

_NAME_WORLD = "name a rig file of kind simulated with --world FILE"


def serve_rehearsal(
    file: Path,
    *,
    world: Path | None,
    faults: Path | None,
    seed: int,
    journal: Path | None,
    as_json: bool,
) -> None:
    """Serve the rig of a file until a signal comes.

    Parameters
    ----------
    file : Path
        The rig file with which labrig is going to open the rig.
    world : Path or None
        Rig file whose world is simulated; None: the simulated rig beside `file`.
    faults : Path or None
        File of faults.
    seed : int
        Seed of the world.
    journal : Path or None
        File for the events of the drives.
    as_json : bool
        Whether the line that says that all is ready is a JSON document.

    Raises
    ------
    InputError
        When a file cannot be used.
    MachineError
        When a port is in use, or the journal cannot be written.
    """
    rig = load_rig(file)
    rehearsal = Rehearsal(
        rig,
        _load_world(world or _find_world_file(file)),
        seed,
        load_faults(faults) if faults else (),
    )
    with note_signals() as interrupted:
        serve_rig(
            rehearsal,
            until=interrupted,
            ready=lambda: _say_ready(rig, as_json=as_json),
            typed=TypedLines(sys.stdin).take,
            report=say,
            journal=journal,
        )


def _say_ready(rig: RigDescription, *, as_json: bool) -> None:
    nodes = [node for _, axis in rig.axes.items() for node in axis.nodes]
    if as_json:
        print_json({"can": rig.can.channel, "camera": rig.camera.address, "nodes": nodes})
    else:
        listed = ",".join(map(str, nodes))
        print_line(f"ready: nodes {listed} on {rig.can.channel}, camera on {rig.camera.address}")
    say_wrapped(f"Type here what your hands do at the bench: {HELP}")


def _find_world_file(rig: Path) -> Path:
    """Return the simulated rig beside a rig file. Raises `InputError` if there is none."""
    beside = rig.parent / SIMULATED_RIG.name
    if not beside.is_file():
        raise InputError(f"no world: there is no {beside}", _NAME_WORLD)
    return beside


def _load_world(file: Path) -> WorldDescription:
    """Return the world of a simulated rig. Raises `InputError` if the file has none."""
    world = load_rig(file).world
    if world is None:
        raise InputError(f"{file} has no section world", _NAME_WORLD)
    return world
