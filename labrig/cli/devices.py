"""`labrig devices`: checks the rig, shows its camera, moves it axis by axis, and stops it."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from labrig.cli.devices_motion import home, jog, withdraw
from labrig.cli.options import RigOption
from labrig.cli.output import AsJson, print_checks, print_json, print_line, say
from labrig.errors import InputError
from labrig.library.names import find_rig_file

_INTERRUPTED = 130

app = typer.Typer(no_args_is_help=True)


@app.command("check", help="Check bus, drives, camera, calibration and disk, and say what to do about each.")
def check(
    rig: RigOption = None,
    move: Annotated[
        bool,
        typer.Option(
            "--move",
            help="Move each axis a little too, and see that it stops by itself when labrig falls silent.",
        ),
    ] = False,
    as_json: AsJson = False,
) -> int:
    """Exit with 1 when a check failed."""
    from labrig.devices.check import check_rig
    from labrig.devices.check_result import CheckResult, CheckStatus
    from labrig.devices.dead_man import try_dead_man
    from labrig.devices.rig_file import load_rig
    from labrig.library.plugin_faults import find_plugin_faults
    from labrig.plugins import CAMERAS, DRIVES, EXPERIMENTS

    description = load_rig(find_rig_file(rig))
    results = check_rig(description)
    if move:
        results += try_dead_man(description, lambda what: typer.confirm(f"{what}. Go on?", err=True))
    results += [
        CheckResult("plugin", CheckStatus.WARN, fault.message, fault.hint)
        for fault in find_plugin_faults(DRIVES, CAMERAS, EXPERIMENTS)
    ]
    return print_checks([asdict(result) for result in results], as_json)


@app.command(
    "stop",
    help="Stop every axis of the rig now: end the labrig that uses it, and stop each drive over the bus.",
)
def stop(rig: RigOption = None, as_json: AsJson = False) -> None:
    """End the labrig that uses the rig, then stop every node over the bus; the file need not say more than those."""
    from labrig.devices.stop import read_stop_target, stop_rig

    report = stop_rig(read_stop_target(find_rig_file(rig)))
    if as_json:
        print_json({"by": report.by, "done": list(report.done)})
    for line in report.done:
        say(line)


@app.command(
    "camera", help="Show the camera's picture with scores of focus, exposure and flicker, and what is in it."
)
def camera(
    rig: RigOption = None,
    web: Annotated[
        bool,
        typer.Option(
            "--web", help="Show the picture in a browser too, on this computer alone, until interrupted."
        ),
    ] = False,
    pictures: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=100_000,
            help="Take so many pictures and end. Default: 16; with --web until interrupted.",
        ),
    ] = None,
    save: Annotated[
        Path | None,
        typer.Option(metavar="FILE.png", help="Write the last picture to a new file, as a test frame."),
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Exit with 1 when a score of the last picture is beyond its limit, and with 130 when interrupted."""
    from labrig.cli.camera_view import view_camera
    from labrig.devices.rig_file import load_rig

    return view_camera(load_rig(find_rig_file(rig)), web=web, pictures=pictures, save=save, as_json=as_json)


@app.command("simulate", help="Serve simulated EPOS2 drives to any CANopen client, until interrupted.")
def simulate(
    interface: Annotated[
        str,
        typer.Option(
            help="Interface of python-can, such as socketcan or udp_multicast; slcan makes a serial line."
        ),
    ],
    channel: Annotated[
        str, typer.Option(help="Channel of the interface, such as can0 or 239.74.163.2.")
    ] = "",
    port: Annotated[int | None, typer.Option(help="UDP port, for udp_multicast.", min=1, max=65535)] = None,
    bitrate: Annotated[int, typer.Option(help="Bit rate of the bus [bit/s].")] = 1_000_000,
    nodes: Annotated[str, typer.Option(help="Node ids, separated by commas.")] = "1,2,3",
) -> int:
    """Serve until a signal comes, and exit with 130, as every interrupted command does."""
    from labrig.cli.signals import note_signals
    from labrig.devices.simulated.serving import ServedDrives, open_bus
    from labrig.devices.simulated.slcan import SlcanAdapter

    node_ids = _read_node_ids(nodes)
    if interface == "virtual":
        raise InputError(
            "the interface virtual ends with the process, nobody could reach the drives",
            "use udp_multicast or slcan",
        )
    with note_signals() as interrupted, open_bus(interface, channel, port, bitrate) as bus:
        drives = ServedDrives(bus, node_ids)
        reached_by = bus.path if isinstance(bus, SlcanAdapter) else channel
        listed = ",".join(map(str, node_ids))
        print_line(f"ready: nodes {listed} on {interface} {reached_by}".rstrip())
        drives.serve(interrupted)
    return _INTERRUPTED


def _read_node_ids(text: str) -> list[int]:
    """Return the node ids of `1,2,3`. Raises `InputError`."""
    parts = [part.strip() for part in text.split(",")]
    ids = [int(part) if part.isascii() and part.isdigit() else 0 for part in parts]
    if any(not 1 <= node_id <= 127 for node_id in ids) or len(set(ids)) != len(ids):
        raise InputError(
            f"--nodes {text} is not a list of different node ids", "give ids from 1 to 127: 1,2,3"
        )
    return ids


app.command("home", help="Home axes after confirmation; refused with a needle in tissue.")(home)
app.command(
    "jog", help="Move one axis slowly after confirmation; verify direction, lead, backlash and limits."
)(jog)
app.command("withdraw", help="Withdraw a needle that a run has left in tissue, along its path.")(withdraw)
