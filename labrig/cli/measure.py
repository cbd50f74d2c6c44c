"""`labrig measure`: measures pictures that belong to no run."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from labrig.cli.options import (
    DEFAULT_NEEDLE_DIAMETER_MM,
    IntrinsicsOption,
    MaskOption,
    NeedleDiameterOption,
    OptionalInsertion,
    OriginOption,
    PlaneOption,
    PxPerMmOption,
    SheathDiameterOption,
)
from labrig.cli.output import AsJson, print_json, print_table, say
from labrig.errors import InputError, PictureError
from labrig.text import interval, number

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
    window_start_mm: Annotated[float, typer.Option(help="Arc length left out behind the sheath.")] = 4.0,
    window_end_mm: Annotated[float, typer.Option(help="Arc length left out before the tip.")] = 2.0,
    roll_sd_deg: Annotated[
        float | None,
        typer.Option(
            min=0,
            max=30,
            help="Standard deviation of the bevel's roll; 2 if it was set by eye. Default: not in the interval.",
            show_default=False,
        ),
    ] = None,
    mask: MaskOption = None,
    as_json: AsJson = False,
) -> int:
    """Exit with 0 when every picture has a radius, 1 otherwise, 2 when no picture could be read."""
    from labrig.analysis.calibration import list_not_in_interval
    from labrig.cli.mapping import load_plane_map
    from labrig.vision.curvature import CurvatureSettings, measure_curvature
    from labrig.vision.mask import load_mask
    from labrig.vision.picture import read_picture

    mapping = load_plane_map(intrinsics, plane, px_per_mm, origin_px, insertion)
    settings = CurvatureSettings(
        needle_diameter_mm=needle_diameter_mm,
        sheath_diameter_mm=sheath_diameter_mm,
        window_start_mm=window_start_mm,
        window_end_mm=window_end_mm,
        roll_sd_rad=None if roll_sd_deg is None else math.radians(roll_sd_deg),
    )
    not_needle = None if mask is None else load_mask(mask)

    def measure(path: Path) -> dict[str, object]:
        image = read_picture(path)
        masked = None if not_needle is None else not_needle.find_masked(path.name, image)
        found = measure_curvature(image, mapping, settings, masked=masked)
        return {
            **found.to_json(),
            "not_in_interval": list(list_not_in_interval(mapping, [found.radius_budget_mm])),
        }

    rows = _measure_each(images, measure, NOTHING)
    if as_json:
        print_json(rows)
    else:
        _print(rows)
    return 0 if all(row["accepted"] for row in rows) else 1


@app.command("tip", help="Find the needle's tip in each picture by a template.")
def tip(
    images: Annotated[list[Path], typer.Argument(metavar="IMAGE...", help="Pictures of a needle.")],
    template: Annotated[
        Path,
        typer.Option(metavar="FILE", help="Picture of a tip; a JSON file of the same name is beside it."),
    ],
    heading_deg: Annotated[
        float | None,
        typer.Option(
            help="Heading of the needle, within 7 degrees. Default: try all headings.",
            show_default=False,
        ),
    ] = None,
    near_px: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="U V",
            help="Approximate place of the tip. Default: search the whole picture.",
            show_default=False,
        ),
    ] = None,
    region_px: Annotated[float, typer.Option(help="Side of the square around --near-px.")] = 120.0,
    mask: MaskOption = None,
    intrinsics: IntrinsicsOption = None,
    plane: PlaneOption = None,
    px_per_mm: PxPerMmOption = None,
    origin_px: OriginOption = None,
    insertion: OptionalInsertion = None,
    as_json: AsJson = False,
) -> int:
    """Exit with 0 when every picture has a tip, 1 otherwise, 2 when no picture could be used."""
    from labrig.cli.mapping import load_plane_map
    from labrig.cli.tip_search import TipSearch, search_tip
    from labrig.vision.mask import load_mask
    from labrig.vision.template_file import load_template

    mapping = load_plane_map(intrinsics, plane, px_per_mm, origin_px, insertion)
    search = TipSearch(
        load_template(template).relative_to(mapping.insertion),
        heading_deg,
        near_px,
        region_px,
        None if mask is None else load_mask(mask),
    )

    def measure(path: Path) -> dict[str, object]:
        return search_tip(path, mapping, search)

    rows = _measure_each(images, measure, NO_TIP)
    if as_json:
        print_json(rows)
    else:
        _print_tips(rows)
    return 0 if all(row["accepted"] for row in rows) else 1


def _measure_each(
    images: list[Path], measure: Callable[[Path], dict[str, object]], nothing: dict[str, object]
) -> list[dict[str, object]]:
    """Return a row for each picture; the row of a picture that cannot be used has the reason.

    Raises
    ------
    InputError
        When no picture can be used.
    """
    rows: list[dict[str, object]] = []
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


NOTHING: dict[str, object] = {
    "found": False,
    "accepted": False,
    "reason": None,
    "radius_mm": None,
    "radius_ci95_mm": None,
    "radius_budget_mm": None,
    "not_in_interval": [],
    "centre_mm": None,
    "tip_mm": None,
    "tip_budget_mm": None,
    "arc_length_mm": None,
    "residual_rms_mm": None,
}

NO_TIP: dict[str, object] = {
    "accepted": False,
    "reason": None,
    "tip_px": None,
    "tip_mm": None,
    "tip_budget_mm": None,
    "not_in_interval": [],
    "heading_rad": None,
    "score": None,
    "distinctness": None,
}


def _print(rows: list[dict[str, object]]) -> None:
    heads = ("picture", "radius mm", "95 % interval mm", "mostly from", "arc mm", "tip y, z mm")
    cells = []
    for row in rows:
        radius = number(row["radius_mm"], 2) if row["accepted"] else "-"
        ci95 = interval(row["radius_ci95_mm"]) if row["accepted"] else "-"
        cells.append(
            [
                Path(str(row["image"])).name,
                radius,
                ci95,
                _name_largest(row["radius_budget_mm"]) if row["accepted"] else "-",
                number(row["arc_length_mm"], 1),
                _format_pair(row["tip_mm"]),
            ]
        )
    print_table(heads, cells)
    _say_rest(rows)


def _say_rest(rows: list[dict[str, object]]) -> None:
    """Say why pictures are refused, and which sources of error are not in the interval of the others."""
    for row in rows:
        if row["reason"]:
            say(f"{Path(str(row['image'])).name}: {row['reason']}")
    left_out = next(
        (found for row in rows if isinstance(found := row["not_in_interval"], list) and found), ()
    )
    if left_out:
        say(f"Not in the interval: {', '.join(left_out)}.")


def _name_largest(document: object) -> str:
    """Return the largest source of error with its standard deviation."""
    from labrig.vision.error_budget import ErrorBudget

    budget = ErrorBudget(**document) if isinstance(document, dict) else ErrorBudget()
    return (
        "-" if budget.largest is None else f"{budget.largest} ± {number(getattr(budget, budget.largest), 3)}"
    )


def _print_tips(rows: list[dict[str, object]]) -> None:
    heads = ("picture", "tip u, v px", "tip y, z mm", "mostly from", "score")
    cells = [
        [
            Path(str(row["image"])).name,
            _format_pair(row["tip_px"]),
            _format_pair(row["tip_mm"]),
            _name_largest(row["tip_budget_mm"]),
            number(row["score"], 3),
        ]
        for row in rows
    ]
    print_table(heads, cells)
    _say_rest(rows)


def _format_pair(value: object) -> str:
    return f"{value[0]:.2f}, {value[1]:.2f}" if isinstance(value, list | tuple) else "-"
