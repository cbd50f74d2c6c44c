"""`labrig devices simulate`: simulated drives on a bus that other programs can join, or a whole rig for a rehearsal."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from labrig.cli.calibration_files import require_writable
from labrig.cli.output import AsJson, print_json, print_line
from labrig.cli.signals import note_signals
from labrig.errors import InputError

_INTERRUPTED = 130
_BITRATE, _NODES = 1_000_000, "1,2,3"


def simulate(
    rig: Annotated[
        Path | None,
        typer.Option(
            "--rig",
            metavar="FILE",
            help="Serve the drives and the camera of this rig file, such as calibration/rig-rehearsal.yaml, and do "
            "what is typed: needle, specimen, hole, board, paper, clear, scale.",
            show_default=False,
        ),
    ] = None,
    world: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="With --rig: rig file whose section world is simulated. Default: rig-simulated.yaml beside it.",
            show_default=False,
        ),
    ] = None,
    faults: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="With --rig: file with a list faults, as in a simulated rig; times count from the start.",
            show_default=False,
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="With --rig: seed of the world.")] = 0,
    interface: Annotated[
        str | None,
        typer.Option(
            help="Instead of --rig: serve EPOS2 drives on this interface of python-can, such as socketcan or "
            "udp_multicast; slcan makes a serial port.",
            show_default=False,
        ),
    ] = None,
    channel: Annotated[
        str, typer.Option(help="Channel of the interface, such as can0 or 239.74.163.2.")
    ] = "",
    port: Annotated[int | None, typer.Option(help="UDP port, for udp_multicast.")] = None,
    bitrate: Annotated[
        int | None,
        typer.Option(help=f"Bitrate of the bus in bit/s. Default: {_BITRATE}.", show_default=False),
    ] = None,
    nodes: Annotated[
        str | None,
        typer.Option(help=f"Node ids, separated by commas. Default: {_NODES}.", show_default=False),
    ] = None,
    journal: Annotated[
        Path | None,
        typer.Option(help="Write the events of the drives to this file at the end, one JSON line each."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing journal.")] = False,
    as_json: AsJson = False,
) -> int:
    """Serve until a signal comes, and exit with 130, as every interrupted command does."""
    if (rig is None) == (interface is None):
        raise InputError("either --rig or --interface says what is served", "give one of them")
    require_writable(journal, force)
    if rig is not None:
        from labrig.cli.rehearsal import serve_rehearsal

        _refuse("--interface", {"--channel": channel, "--port": port, "--bitrate": bitrate, "--nodes": nodes})
        serve_rehearsal(rig, world=world, faults=faults, seed=seed, journal=journal, as_json=as_json)
        return _INTERRUPTED
    from labrig.devices.simulated.serving import ServedBus, serve_drives

    _refuse("--rig", {"--world": world, "--faults": faults, "--seed": seed})
    served = ServedBus(interface or "", channel, port, bitrate or _BITRATE)
    node_ids = _node_ids(nodes or _NODES)

    def ready(reached_by: str) -> None:
        if as_json:
            print_json({"interface": interface, "channel": reached_by, "nodes": node_ids})
        else:
            listed = ",".join(map(str, node_ids))
            print_line(f"ready: nodes {listed} on {interface} {reached_by}".rstrip())

    with note_signals() as interrupted:
        serve_drives(served, node_ids, until=interrupted, ready=ready, journal=journal)
    return _INTERRUPTED


def _refuse(belonging_to: str, options: Mapping[str, object]) -> None:
    """Refuse options that have been given and have no effect."""
    if given := [name for name, value in options.items() if value]:
        raise InputError(f"{', '.join(given)} belongs to {belonging_to}", "leave it out")


def _node_ids(text: str) -> list[int]:
    """Return the node ids of `1,2,3`. Raises `InputError`."""
    parts = [part.strip() for part in text.split(",")]
    ids = [int(part) if part.isascii() and part.isdigit() else 0 for part in parts]
    if any(not 1 <= node_id <= 127 for node_id in ids) or len(set(ids)) != len(ids):
        raise InputError(
            f"--nodes {text} is not a list of different node ids", "give ids from 1 to 127: 1,2,3"
        )
    return ids
