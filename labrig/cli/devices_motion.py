"""`labrig devices home|jog|withdraw`: commission a rig axis by axis, and withdraw a needle from tissue."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from labrig.cli.options import RigOption, RunsDirOption, YesOption, find_runs_dir
from labrig.cli.output import AsJson

_AXES = "insertion, rotation or linear"
_GENTLE_MA = 1000

CurrentOption = Annotated[
    int,
    typer.Option(
        "--current-ma",
        min=0,
        max=20_000,
        help="Limit of the drives' output current in mA; 0 leaves their own limits.",
    ),
]


def home(
    axis: Annotated[
        list[str] | None,
        typer.Option(
            "--axis", metavar="NAME", help=f"{_AXES}; repeatable. Default: all.", show_default=False
        ),
    ] = None,
    needle: Annotated[
        Literal["mounted", "none"],
        typer.Option(help="Whether a needle is in the clamp; if so, no search that could bend it."),
    ] = "mounted",
    method: Annotated[
        int | None,
        typer.Option(help="Homing method of the drive. Default: the rig file's.", show_default=False),
    ] = None,
    rig: RigOption = None,
    current_ma: CurrentOption = _GENTLE_MA,
    yes: YesOption = False,
    as_json: AsJson = False,
) -> int:
    """Home the linear module first."""
    from labrig.cli.commissioning import CommissioningOptions, home_and_print

    return home_and_print(
        CommissioningOptions(rig, current_ma, yes, as_json), axis, method, needle_mounted=needle == "mounted"
    )


def jog(
    axis: Annotated[str, typer.Option("--axis", metavar="NAME", help=f"{_AXES}.")],
    distance: Annotated[
        float | None,
        typer.Option(
            "--distance",
            help="Signed distance in mm or rad; without a reference at most 20 mm or half a turn. "
            "Default: 10 mm or a quarter turn.",
            show_default=False,
        ),
    ] = None,
    check: Annotated[
        Literal["travel", "backlash", "limits"] | None,
        typer.Option(
            help="travel: compare with your reading of graph paper. backlash: measure the play on the way back. "
            "limits: go to both limits of a referenced axis.",
            show_default=False,
        ),
    ] = None,
    speed: Annotated[
        float | None,
        typer.Option(
            "--speed",
            help="Speed in mm/s or rad/s, at most 5 mm/s or 1 rad/s. Default: 1 mm/s or 0.2 rad/s.",
            show_default=False,
        ),
    ] = None,
    rig: RigOption = None,
    current_ma: CurrentOption = _GENTLE_MA,
    yes: YesOption = False,
    as_json: AsJson = False,
) -> int:
    """Exit with 1 when a check found the rig file wrong; the file is never changed."""
    from labrig.cli.commissioning import CommissioningOptions, jog_and_print

    return jog_and_print(CommissioningOptions(rig, current_ma, yes, as_json), axis, distance, speed, check)


def withdraw(
    run: Annotated[
        Path | None,
        typer.Option(
            "--run",
            metavar="RUN",
            help="Run that left the needle. Default: the run that the rig remembers.",
            show_default=False,
        ),
    ] = None,
    insertion_mm: Annotated[
        float | None,
        typer.Option(
            help="Length in mm of the needle outside the sheath, if not as recorded.", show_default=False
        ),
    ] = None,
    rotation_rad: Annotated[
        float | None,
        typer.Option(help="Rotation of the needle in rad, if not as recorded.", show_default=False),
    ] = None,
    linear_mm: Annotated[
        float | None,
        typer.Option(help="Position of the sheath in mm, if not as recorded.", show_default=False),
    ] = None,
    rig: RigOption = None,
    runs_dir: RunsDirOption = None,
    yes: YesOption = False,
    as_json: AsJson = False,
) -> int:
    """Exit with 0 when the needle is out; the withdrawal is recorded as a run of its own."""
    from labrig.cli.withdraw import withdraw_and_print

    given = {"insertion_mm": insertion_mm, "rotation_rad": rotation_rad, "linear_mm": linear_mm}
    standing = {key: value for key, value in given.items() if value is not None}
    return withdraw_and_print(rig, run, find_runs_dir(runs_dir), standing, yes=yes, as_json=as_json)
