"""`labrig devices simulate`: simulated drives on a bus that other programs can join."""

from pathlib import Path
from typing import Annotated

import typer

from labrig.cli.calibration_files import require_writable
from labrig.cli.output import AsJson, print_json, print_line
from labrig.cli.signals import note_signals
from labrig.errors import InputError

_INTERRUPTED = 130


def simulate(
    interface: Annotated[
        str,
        typer.Option(
            help="Interface of python-can, such as socketcan or udp_multicast; slcan makes a serial port."
        ),
    ],
    channel: Annotated[
        str, typer.Option(help="Channel of the interface, such as can0 or 239.74.163.2.")
    ] = "",
    port: Annotated[int | None, typer.Option(help="UDP port, for udp_multicast.")] = None,
    bitrate: Annotated[int, typer.Option(help="Bitrate of the bus in bit/s.")] = 1_000_000,
    nodes: Annotated[str, typer.Option(help="Node ids, separated by commas.")] = "1,2,3",
    journal: Annotated[
        Path | None,
        typer.Option(help="Write the events of the drives to this file at the end, one JSON line each."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing journal.")] = False,
    as_json: AsJson = False,
) -> int:
    """Serve until a signal comes, and exit with 130, as every interrupted command does."""
    from labrig.devices.simulated.serving import ServedBus, serve_drives

    node_ids = _node_ids(nodes)
    require_writable(journal, force)

    def ready(reached_by: str) -> None:
        if as_json:
            print_json({"interface": interface, "channel": reached_by, "nodes": node_ids})
        else:
            print_line(f"ready: nodes {nodes} on {interface} {reached_by}".rstrip())

    with note_signals() as interrupted:
        serve_drives(
            ServedBus(interface, channel, port, bitrate),
            node_ids,
            until=interrupted,
            ready=ready,
            journal=journal,
        )
    return _INTERRUPTED


def _node_ids(text: str) -> list[int]:
    """Return the node ids of `1,2,3`. Raises `InputError`."""
    parts = [part.strip() for part in text.split(",")]
    ids = [int(part) if part.isascii() and part.isdigit() else 0 for part in parts]
    if any(not 1 <= node_id <= 127 for node_id in ids) or len(set(ids)) != len(ids):
        raise InputError(
            f"--nodes {text} is not a list of different node ids", "give ids from 1 to 127: 1,2,3"
        )
    return ids
