"""`labrig measure`: what loose pictures say."""

from pathlib import Path
from typing import Annotated

import typer

from labrig.cli.options import OptionalInsertion
from labrig.cli.output import AsJson, interval, number, print_json, print_table, say
from labrig.errors import InputError, PictureError

app = typer.Typer(help="Measure loose pictures.", no_args_is_help=True)


@app.callback()
def _measure() -> None:
    pass


@app.command("curvature", help="Shaft, tip and radius of curvature in each picture.")
def curvature(
    images: Annotated[list[Path], typer.Argument(metavar="IMAGE...", help="Pictures of a needle.")],
    intrinsics: Annotated[
        Path | None,
        typer.Option("--intrinsics", metavar="FILE", help="Intrinsics of the camera.", show_default=False),
    ] = None,
    plane: Annotated[
        Path | None,
        typer.Option("--plane", metavar="FILE", help="Plane map of the camera.", show_default=False),
    ] = None,
    px_per_mm: Annotated[
        float | None, typer.Option(help="Scale of rectified pictures.", show_default=False)
    ] = None,
    origin_px: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="U V", help="Pixel of the plane's origin.", show_default=False),
    ] = None,
    insertion: OptionalInsertion = None,
    needle_diameter_mm: Annotated[float, typer.Option(help="Outer diameter of the needle.")] = 1.2,
    sheath_diameter_mm: Annotated[
        float | None,
        typer.Option(help="Outer diameter of the sheath, where one is in the picture.", show_default=False),
    ] = None,
    window_start_mm: Annotated[float, typer.Option(help="Arc length left off behind the sheath.")] = 4.0,
    window_end_mm: Annotated[float, typer.Option(help="Arc length left off at the tip.")] = 2.0,
    as_json: AsJson = False,
) -> int:
    """Exit with 0 when a radius could be stated in every picture, 1 otherwise, 2 when no picture could be read."""
    from labrig.cli.mapping import plane_map
    from labrig.vision import CurvatureSettings, measure_curvature, read_picture

    mapping = plane_map(intrinsics, plane, px_per_mm, origin_px, insertion)
    settings = CurvatureSettings(
        needle_diameter_mm=needle_diameter_mm,
        sheath_diameter_mm=sheath_diameter_mm,
        window_start_mm=window_start_mm,
        window_end_mm=window_end_mm,
    )
    rows: list[dict[str, object]] = []
    refusals: list[PictureError] = []
    for path in images:
        try:
            measured = measure_curvature(read_picture(path), mapping, settings)
            rows.append({"image": str(path), **measured.to_json()})
        except PictureError as error:
            rows.append({"image": str(path), **NOTHING, "reason": error.message})
            refusals.append(error)
    if len(refusals) == len(images):
        raise InputError(f"no picture can be used: {refusals[0].message}", refusals[0].hint)
    if as_json:
        print_json(rows)
    else:
        _print(rows)
    return 0 if all(row["accepted"] for row in rows) else 1


NOTHING: dict[str, object] = {
    "found": False,
    "accepted": False,
    "reason": None,
    "radius_mm": None,
    "radius_ci95_mm": None,
    "centre_mm": None,
    "tip_mm": None,
    "arc_length_mm": None,
    "residual_rms_mm": None,
}


def _print(rows: list[dict[str, object]]) -> None:
    heads = ("picture", "radius mm", "95 % interval mm", "arc mm", "tip y, z mm")
    cells = []
    for row in rows:
        tip = row["tip_mm"]
        tip_text = f"{tip[0]:.2f}, {tip[1]:.2f}" if isinstance(tip, list | tuple) else "-"
        radius = number(row["radius_mm"], 2) if row["accepted"] else "-"
        ci95 = interval(row["radius_ci95_mm"]) if row["accepted"] else "-"
        cells.append([Path(str(row["image"])).name, radius, ci95, number(row["arc_length_mm"], 1), tip_text])
    print_table(heads, cells)
    for row in rows:
        if row["reason"]:
            say(f"{Path(str(row['image'])).name}: {row['reason']}")
