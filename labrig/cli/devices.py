"""`labrig devices`: checks the rig, shows its camera, moves it axis by axis, and stops it."""

from dataclasses import asdict

import typer

from labrig.cli.devices_camera import camera
from labrig.cli.devices_motion import home, jog, withdraw
from labrig.cli.devices_simulate import simulate
from labrig.cli.options import RigOption, find_rig_file
from labrig.cli.output import AsJson, print_checks, print_json, say
from labrig.cli.plugin_faults import find_plugin_faults
from labrig.devices.check_result import CheckResult, CheckStatus
from labrig.plugins import CAMERAS, DRIVES, EXPERIMENTS

app = typer.Typer(no_args_is_help=True)


@app.command("check", help="Check bus, drives, camera, calibration and disk, and say what to do about each.")
def check(rig: RigOption = None, as_json: AsJson = False) -> int:
    """Exit with 1 when a check failed."""
    from labrig.devices.check import check_rig
    from labrig.devices.rig_file import load_rig

    results = check_rig(load_rig(find_rig_file(rig)))
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


app.command(
    "camera",
    help="Show the camera's picture with scores of focus, saturation, exposure and flicker, and what is found in it.",
)(camera)
app.command("home", help="Home axes after confirmation; refused with a needle in tissue.")(home)
app.command(
    "jog", help="Move one axis slowly after confirmation; verify direction, lead, backlash and limits."
)(jog)
app.command("withdraw", help="Withdraw a needle that a run has left in tissue, along its path.")(withdraw)
app.command(
    "simulate",
    help="Serve simulated EPOS2 drives to any CANopen client, until interrupted.",
)(simulate)
