"""`labrig devices`: checks the rig, shows its camera, moves it axis by axis, withdraws a needle, and stops it."""

import math
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal

from typer import Option

from labrig.cli.options import RigOption, find_runs_dir
from labrig.cli.output import print_checks, print_json, print_line, say
from labrig.errors import InputError, InterruptedRunError, SafetyStopError, WireError
from labrig.library.names import find_rig_file

AxisName = StrEnum("AxisName", ["insertion", "rotation", "linear"])
_CURRENT_HELP = "Limit of the drives' output current in mA; 0 leaves their own limits."
CurrentOption = Annotated[int, Option(min=0, max=20_000, help=_CURRENT_HELP)]
_GENTLE_MA = 1000


def check(
    rig: RigOption = None,
    move: Annotated[
        bool,
        Option("--move", help="Move each axis a little too, and see that it stops when labrig falls silent."),
    ] = False,
) -> int:
    """Exit with 1 when a check failed."""
    from labrig.devices.axis_description import AXES
    from labrig.devices.check import check_rig
    from labrig.devices.check_result import CheckResult, CheckStatus, failed
    from labrig.devices.clocks import SystemClock
    from labrig.devices.dead_man import try_dead_man
    from labrig.devices.rig_file import load_rig
    from labrig.library.calibration_ages import list_calibration_ages
    from labrig.library.plugin_faults import find_plugin_faults
    from labrig.plugins import CAMERAS, DRIVES, EXPERIMENTS

    description = load_rig(find_rig_file(rig))
    results = [*check_rig(description), *list_calibration_ages(description, SystemClock().utc())]
    if move:
        for name in AXES:
            try:
                with _open_axes(rig, (name,), 0, "labrig devices check --move") as opened:
                    results.append(try_dead_man(opened, name))
            except WireError as error:
                results.append(failed(f"silence {name}", error))
    results += [
        CheckResult("plugin", CheckStatus.WARN, fault.message, fault.hint)
        for fault in find_plugin_faults(DRIVES, CAMERAS, EXPERIMENTS)
    ]
    return _print_findings(results)


def _print_findings(findings: Sequence[Any]) -> int:
    checks = [asdict(finding) for finding in findings]
    print_json(checks)
    return print_checks(checks)


def stop(rig: RigOption = None) -> None:
    """End the labrig that uses the rig, then stop every node over the bus; the file need not say more than those."""
    from labrig.devices.stop import read_stop_target, stop_rig

    done = stop_rig(read_stop_target(find_rig_file(rig)))
    print_json({"done": list(done)})
    for line in done:
        say(line)


def camera(
    rig: RigOption = None,
    web: Annotated[
        bool, Option("--web", help="Show it in a browser on this computer, until interrupted.")
    ] = False,
    save: Annotated[
        Path | None, Option(metavar="FILE.png", help="Write the last picture to a new file, as a test frame.")
    ] = None,
) -> int:
    """Score 16 pictures; exit with 1 when the last is beyond a limit, and with 130 when interrupted."""
    from labrig.cli.camera import view_camera
    from labrig.devices.rig_file import load_rig

    return view_camera(load_rig(find_rig_file(rig)), web=web, save=save)


def simulate(
    interface: Annotated[
        str, Option(help="Interface of python-can, such as udp_multicast; slcan makes a serial line.")
    ],
    channel: Annotated[str, Option(help="Channel of the interface, such as can0 or 239.74.163.2.")] = "",
    port: Annotated[int | None, Option(help="UDP port, for udp_multicast.", min=1, max=65535)] = None,
    bitrate: Annotated[int, Option(help="Bit rate of the bus [bit/s].")] = 1_000_000,
    nodes: Annotated[str, Option(help="Node ids, separated by commas.")] = "1,2,3",
) -> int:
    """Serve until a signal comes, and exit with 130, as every interrupted command does."""
    from labrig.cli.signals import note_signals
    from labrig.devices.simulated.serving import ServedDrives, open_bus
    from labrig.devices.simulated.slcan import SlcanAdapter

    node_ids = [int(part) if part.strip().isdecimal() else 0 for part in nodes.split(",")]
    if any(not 1 <= node_id <= 127 for node_id in node_ids) or len(set(node_ids)) != len(node_ids):
        raise InputError(
            f"--nodes {nodes} is not a list of different node ids", "give ids from 1 to 127: 1,2,3"
        )
    if interface == "virtual":
        raise InputError(
            "the interface virtual ends with the process, nobody could reach the drives",
            "use udp_multicast or slcan",
        )
    with note_signals() as interrupted, open_bus(interface, channel, port, bitrate) as bus:
        drives = ServedDrives(bus, node_ids)
        reached_by = str(bus.path) if isinstance(bus, SlcanAdapter) else channel
        print_json({"nodes": node_ids, "interface": interface, "channel": reached_by})
        print_line(f"ready: nodes {','.join(map(str, node_ids))} on {interface} {reached_by}".rstrip())
        drives.serve(interrupted)
    return InterruptedRunError.exit_code


def home(
    axis: Annotated[list[AxisName] | None, Option(help="Repeatable. Default: all.")] = None,
    needle: Annotated[
        Literal["mounted", "none"], Option(help="Whether one is in the clamp: no search may bend it.")
    ] = "mounted",
    method: Annotated[
        int | None, Option(help="Homing method; 35 homes where the axis stands. Default: the rig file's.")
    ] = None,
    rig: RigOption = None,
    current_ma: CurrentOption = _GENTLE_MA,
) -> int:
    """Home the linear module first."""
    from labrig.devices.homing import HOME_ORDER
    from labrig.devices.rig_file import load_rig
    from labrig.library.commissioning import home_axes

    chosen = tuple(axis or HOME_ORDER)
    for name, description in load_rig(find_rig_file(rig)).axes.items():
        if method is not None and name in chosen and method not in description.homing_directions:
            methods = ", ".join(map(str, description.homing_directions))
            raise InputError(f"--method {method} is not a method that labrig uses", f"use one of {methods}")
    with _open_axes(rig, chosen, current_ma, "labrig devices home") as opened:
        findings = home_axes(opened, method, needle_mounted=needle == "mounted")
    return _print_findings(findings)


def jog(
    axis: Annotated[AxisName, Option()],
    distance: Annotated[
        float | None, Option(help="Signed, in mm or rad. Default: 10 mm or a quarter turn.")
    ] = None,
    speed: Annotated[
        float | None, Option(help="At most 5 mm/s or 1 rad/s. Default: 1 mm/s or 0.2 rad/s.")
    ] = None,
    rig: RigOption = None,
    current_ma: CurrentOption = _GENTLE_MA,
) -> int:
    """Compare it with a ruler: a wrong direction is `reversed`, a wrong distance `lead_mm` or `gear_ratio`."""
    from labrig.library import commissioning

    with _open_axes(rig, (axis,), current_ma, "labrig devices jog") as opened:
        far = commissioning.USUAL_DISTANCE[opened.axis(axis).unit] if distance is None else distance
        finding = commissioning.jog(opened, axis, far, speed)
    return _print_findings([finding])


def withdraw(
    run: Annotated[
        Path | None, Option(metavar="RUN", help="Run that left the needle. Default: as the rig remembers.")
    ] = None,
    at: Annotated[
        list[str] | None,
        Option(
            metavar="AXIS=POSITION",
            help="Where it stands if not as recorded: insertion=12.5 is 12.5 mm out of the sheath; repeatable.",
        ),
    ] = None,
    rig: RigOption = None,
) -> int:
    """Exit with 0 when the needle is out; the withdrawal is recorded as a run of its own."""
    from labrig.cli.attendant import TerminalAttendant
    from labrig.cli.finished_run import print_finished
    from labrig.devices.rig_file import load_rig
    from labrig.library.withdrawal import withdraw_needle

    done = withdraw_needle(
        load_rig(find_rig_file(rig)),
        run,
        find_runs_dir(),
        standing=dict(map(_read_position, at or ())),
        attendant=TerminalAttendant(),
        command_line=sys.argv,
    )
    if done.outcome.error is None:
        print_line(f"the needle is out\nrecord  {done.path}")
    return print_finished(done, None)


def _read_position(text: str) -> tuple[str, float]:
    """Return field and value of `AxisPositions` for `insertion=12.5`. Raises `InputError`."""
    fields = {"insertion": "insertion_mm", "rotation": "rotation_rad", "linear": "linear_mm"}
    axis, _, position = text.partition("=")
    with suppress(ValueError):
        if axis in fields and math.isfinite(value := float(position)):
            return fields[axis], value
    raise InputError(f"--at {text} names no axis with its position", "for example --at insertion=12.5")


@contextmanager
def _open_axes(rig: Path | None, axes: tuple[str, ...], current_ma: int, doing: str) -> Iterator[Any]:
    """Open axes of a rig, without its camera, with limited current; faults are reset if the person confirms.

    If bus or drives fail, or a signal ends the work, it says what the needle is doing and where it is.
    """
    from labrig.cli.attendant import TerminalAttendant
    from labrig.cli.finished_run import say_where_needle_is
    from labrig.devices.opening import Opening
    from labrig.devices.rig_file import load_rig

    limits_ma = dict.fromkeys(axes, current_ma) if current_ma else {}
    opening = Opening(axes, camera=False, max_current_ma=limits_ma, reset_faults=True)
    with TerminalAttendant().open_rig(load_rig(find_rig_file(rig)), doing, 0, opening) as (opened, _):
        try:
            yield opened
        except (InterruptedRunError, WireError):
            with suppress(SafetyStopError):  # closing the rig tries again and tells
                opened.stop()
            say_where_needle_is(opened.locate_needle())
            raise
