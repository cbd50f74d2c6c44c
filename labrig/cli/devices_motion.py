"""`labrig devices home|jog|withdraw`: commission a bare rig axis by axis, and take a needle out of tissue."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from labrig.cli.options import DEFAULT_RUNS_DIR, RigOption, RunsDirOption
from labrig.cli.output import AsJson

_AXES = "insertion, rotation or linear"
_GENTLE_MA = 1000

YesOption = Annotated[
    bool, typer.Option("--yes", help="Ask nothing on a simulated rig; never answers on a real one.")
]
CurrentOption = Annotated[
    int,
    typer.Option(
        "--current-ma",
        min=0,
        max=20_000,
        help="Output current in mA that no drive exceeds; 0 leaves the drives' own limits.",
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
        typer.Option(help="Whether a needle is in the clamp; with one, no search that could bend it."),
    ] = "mounted",
    method: Annotated[
        int | None,
        typer.Option(help="Homing method of the drive. Default: that of the rig file.", show_default=False),
    ] = None,
    rig: RigOption = None,
    current_ma: CurrentOption = _GENTLE_MA,
    yes: YesOption = False,
    as_json: AsJson = False,
) -> int:
    """Home the linear module first."""
    from labrig.cli.commissioning import Careful, home_and_tell

    return home_and_tell(
        Careful(rig, current_ma, yes, as_json), axis, method, needle_mounted=needle == "mounted"
    )


def jog(
    axis: Annotated[str, typer.Option("--axis", metavar="NAME", help=f"{_AXES}.")],
    distance: Annotated[
        float | None,
        typer.Option(
            "--distance",
            help="How far in mm or rad, with its sign; of an axis without a reference 20 mm or half a turn at most. "
            "Default: 10 mm or a quarter turn.",
            show_default=False,
        ),
    ] = None,
    check: Annotated[
        Literal["travel", "backlash", "limits"] | None,
        typer.Option(
            help="travel: compare with what you read on graph paper. backlash: the play on the way back. "
            "limits: go to both limits of a referenced axis.",
            show_default=False,
        ),
    ] = None,
    speed: Annotated[
        float | None,
        typer.Option(
            "--speed",
            help="In mm/s or rad/s, 5 mm/s or 1 rad/s at most. Default: 1 mm/s or 0.2 rad/s.",
            show_default=False,
        ),
    ] = None,
    rig: RigOption = None,
    current_ma: CurrentOption = _GENTLE_MA,
    yes: YesOption = False,
    as_json: AsJson = False,
) -> int:
    """Exit with 1 when a check found the rig file wrong; the file is never changed from here."""
    from labrig.cli.commissioning import Careful, jog_and_tell

    return jog_and_tell(Careful(rig, current_ma, yes, as_json), axis, distance, speed, check)


def withdraw(
    run: Annotated[
        Path | None,
        typer.Option(
            "--run",
            metavar="RUN",
            help="Run that left the needle. Default: the one that the rig remembers.",
            show_default=False,
        ),
    ] = None,
    insertion_mm: Annotated[
        float | None,
        typer.Option(
            help="How far in mm it is out of the sheath, if not as the record ends.", show_default=False
        ),
    ] = None,
    rotation_rad: Annotated[
        float | None, typer.Option(help="How far in rad it is turned, likewise.", show_default=False)
    ] = None,
    linear_mm: Annotated[
        float | None, typer.Option(help="Where in mm the sheath stands, likewise.", show_default=False)
    ] = None,
    rig: RigOption = None,
    runs_dir: RunsDirOption = DEFAULT_RUNS_DIR,
    yes: YesOption = False,
    as_json: AsJson = False,
) -> int:
    """Exit with 0 when the needle is out; what was done is recorded as a run of its own."""
    from labrig.cli.withdraw import withdraw_and_tell

    given = {"insertion_mm": insertion_mm, "rotation_rad": rotation_rad, "linear_mm": linear_mm}
    standing = {key: value for key, value in given.items() if value is not None}
    return withdraw_and_tell(rig, run, runs_dir, standing, yes=yes, as_json=as_json)
