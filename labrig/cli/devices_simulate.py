"""`labrig devices simulate`: simulated drives on a bus that other programs can join."""

from typing import Annotated

import typer

from labrig.cli.output import AsJson, print_json, print_line
from labrig.cli.signals import note_signals
from labrig.errors import InputError

_INTERRUPTED = 130


def simulate(
    interface: Annotated[
        str,
        typer.Option(
            help="Interface of python-can, such as socketcan or udp_multicast; slcan stands for adapters over TCP."
        ),
    ],
    channel: Annotated[
        str, typer.Option(help="Channel of the interface, such as can0 or 239.74.163.2.")
    ] = "",
    port: Annotated[
        int | None, typer.Option(help="UDP port, for udp_multicast; TCP port, for slcan.", min=1, max=65535)
    ] = None,
    bitrate: Annotated[int, typer.Option(help="Bit rate of the bus [bit/s].")] = 1_000_000,
    nodes: Annotated[str, typer.Option(help="Node ids, separated by commas.")] = "1,2,3",
    as_json: AsJson = False,
) -> int:
    """Serve until a signal comes, and exit with 130, as every interrupted command does."""
    from labrig.devices.simulated.serving import ServedDrives, open_bus
    from labrig.devices.simulated.slcan_server import SlcanServer

    node_ids = _node_ids(nodes)
    if interface == "virtual":
        raise InputError(
            "the interface virtual ends with the process, nobody could reach the drives",
            "use udp_multicast or slcan",
        )
    with note_signals() as interrupted, open_bus(interface, channel, port, bitrate) as bus:
        drives = ServedDrives(bus, node_ids)
        reached_by = bus.path if isinstance(bus, SlcanServer) else channel
        if as_json:
            print_json({"interface": interface, "channel": reached_by, "nodes": node_ids})
        else:
            listed = ",".join(map(str, node_ids))
            print_line(f"ready: nodes {listed} on {interface} {reached_by}".rstrip())
        drives.serve(interrupted)
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
