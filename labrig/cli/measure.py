"""`labrig measure`: measures pictures that belong to no run."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from labrig.cli.options import (
    DEFAULT_NEEDLE_DIAMETER_MM,
    IntrinsicsOption,
    NeedleDiameterOption,
    OptionalInsertion,
    OriginOption,
    PlaneOption,
    PxPerMmOption,
    SheathDiameterOption,
)
from labrig.cli.output import AsJson, print_table, say, show
from labrig.errors import InputError, PictureError
from labrig.text import interval, number

Row = dict[str, Any]

app = typer.Typer(no_args_is_help=True)


@app.callback()
def _measure() -> None:
    pass


@app.command("curvature", help="Measure shaft, tip and radius of curvature in each picture.")
def curvature(
    images: Annotated[list[Path], typer.Argument(metavar="IMAGE...", help="Pictures of a needle.")],
    intrinsics: IntrinsicsOption = None,
    plane: PlaneOption = None,
    px_per_mm: PxPerMmOption = None,
    origin_px: OriginOption = None,
    insertion: OptionalInsertion = None,
    needle_diameter_mm: NeedleDiameterOption = DEFAULT_NEEDLE_DIAMETER_MM,
    sheath_diameter_mm: SheathDiameterOption = None,
    as_json: AsJson = False,
) -> int:
    """Exit with 0 when every picture has a radius, 1 otherwise, 2 when no picture could be read."""
    from labrig.analysis.pictures import list_not_in_interval
    from labrig.cli.mapping import load_plane_map
    from labrig.vision.curvature import CurvatureSettings, measure_curvature
    from labrig.vision.picture import read_picture

    mapping = load_plane_map(intrinsics, plane, px_per_mm, origin_px, insertion)
    settings = CurvatureSettings(needle_diameter_mm=needle_diameter_mm, sheath_diameter_mm=sheath_diameter_mm)

    def measure(path: Path) -> Row:
        found = measure_curvature(read_picture(path), mapping, settings)
        left_out = list_not_in_interval(mapping, [found.radius_budget_mm])
        return {**found.to_json(), "not_in_interval": list(left_out)}

    rows = _measure_each(images, measure, _NOTHING)
    show(rows, as_json, _print)
    return 0 if all(row["accepted"] for row in rows) else 1


@app.command("tip", help="Find the needle's tip in each picture by a template.")
def tip(
    images: Annotated[list[Path], typer.Argument(metavar="IMAGE...", help="Pictures of a needle.")],
    template: Annotated[
        Path,
        typer.Option(metavar="FILE", help="Picture of a tip; a JSON file of the same name is beside it."),
    ],
    heading_deg: Annotated[
        float | None, typer.Option(help="Heading of the needle, within 7 degrees. Default: try all headings.")
    ] = None,
    near_px: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="U V", help="Place of the tip, within 60 px. Default: search the whole picture."
        ),
    ] = None,
    intrinsics: IntrinsicsOption = None,
    plane: PlaneOption = None,
    px_per_mm: PxPerMmOption = None,
    origin_px: OriginOption = None,
    insertion: OptionalInsertion = None,
    as_json: AsJson = False,
) -> int:
    """Exit with 0 when every picture has a tip, 1 otherwise, 2 when no picture could be used."""
    import numpy as np

    from labrig.analysis.pictures import list_not_in_interval
    from labrig.cli.mapping import load_plane_map
    from labrig.vision.error_budget import PlaceErrors, budget_place
    from labrig.vision.picture import read_picture, require_size
    from labrig.vision.template import load_template
    from labrig.vision.tip import TIP_SIGMA_PX, locate_tip

    mapping = load_plane_map(intrinsics, plane, px_per_mm, origin_px, insertion)
    looked_for = load_template(template).relative_to(mapping.insertion)
    heading_rad = None if heading_deg is None else math.radians(heading_deg)

    def measure(path: Path) -> Row:
        image = read_picture(path)
        if mapping.image_size is not None:
            require_size(image, mapping.image_size, "the plane map")
        fix = locate_tip(image, looked_for, near_px=near_px, heading_rad=heading_rad)
        if fix.tip_px is None:
            return {**_NO_TIP, **fix.model_dump(mode="json")}
        # Light and roll are not in it: no picture tells by how much they change the look of a tip.
        budget = budget_place(mapping, fix.tip_px, PlaceErrors(fit_mm=TIP_SIGMA_PX * mapping.mm_per_px))
        return {
            **fix.model_dump(mode="json"),
            "tip_mm": mapping.to_mm(np.array([fix.tip_px]))[0].tolist(),
            "tip_budget_mm": budget.model_dump(),
            "not_in_interval": list(list_not_in_interval(mapping, [budget])),
        }

    rows = _measure_each(images, measure, _NO_TIP)
    show(rows, as_json, _print_tips)
    return 0 if all(row["accepted"] for row in rows) else 1


def _measure_each(
    images: Sequence[Path], measure: Callable[[Path], Row], nothing: Mapping[str, Any]
) -> list[Row]:
    """Return a row for each picture; the row of a picture that cannot be used has the reason.

    Raises
    ------
    InputError
        When no picture can be used.
    """
    rows: list[Row] = []
    refusals: list[PictureError] = []
    for path in images:
        try:
            rows.append({"image": str(path), **measure(path)})
        except PictureError as error:
            rows.append({"image": str(path), **nothing, "reason": error.message})
            refusals.append(error)
    if len(refusals) == len(images):
        raise InputError(f"no picture can be used: {refusals[0].message}", refusals[0].hint)
    return rows


_NOTHING: Row = {
    **dict.fromkeys(("found", "accepted"), False),
    **dict.fromkeys(("reason", "radius_mm", "radius_ci95_mm", "radius_budget_mm", "centre_mm", "tip_mm")),
    **dict.fromkeys(("tip_budget_mm", "arc_length_mm", "residual_rms_mm")),
    "not_in_interval": [],
}
_NO_TIP: Row = {
    "accepted": False,
    **dict.fromkeys(("reason", "tip_px", "tip_mm", "tip_budget_mm", "heading_rad", "score", "distinctness")),
    "not_in_interval": [],
}


def _print(rows: list[Row]) -> None:
    heads = ("picture", "radius mm", "95 % interval mm", "mostly from", "arc mm", "tip y, z mm")
    cells = []
    for row in rows:
        measured = (
            (
                number(row["radius_mm"], 2),
                interval(row["radius_ci95_mm"]),
                _name_largest(row["radius_budget_mm"]),
            )
            if row["accepted"]
            else (None, None, None)
        )
        tip = _format_pair(row["tip_mm"])
        cells.append([Path(row["image"]).name, *measured, number(row["arc_length_mm"], 1), tip])
    print_table(heads, cells)
    _say_rest(rows)


def _print_tips(rows: list[Row]) -> None:
    heads = ("picture", "tip u, v px", "tip y, z mm", "mostly from", "score")
    cells = [
        [
            Path(row["image"]).name,
            _format_pair(row["tip_px"]),
            _format_pair(row["tip_mm"]),
            _name_largest(row["tip_budget_mm"]),
            number(row["score"], 3),
        ]
        for row in rows
    ]
    print_table(heads, cells)
    _say_rest(rows)


def _say_rest(rows: list[Row]) -> None:
    """Say why pictures are refused, and which sources of error are not in the interval of the others."""
    for row in rows:
        if row["reason"]:
            say(f"{Path(row['image']).name}: {row['reason']}")
    left_out = next((row["not_in_interval"] for row in rows if row["not_in_interval"]), ())
    if left_out:
        say(f"Not in the interval: {', '.join(left_out)}.")


def _name_largest(document: Mapping[str, float] | None) -> str | None:
    """Return the largest source of error with its standard deviation."""
    from labrig.vision.error_budget import ErrorBudget

    budget = ErrorBudget(**(document or {}))
    if budget.largest is None:
        return None
    return f"{budget.largest} ± {number(getattr(budget, budget.largest), 3)}"


def _format_pair(value: Sequence[float] | None) -> str | None:
    return None if value is None else f"{value[0]:.2f}, {value[1]:.2f}"
