"""`labrig measure`: measures pictures that belong to no run."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from labrig.cli.each_picture import use_each
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
from labrig.cli.output import print_json, print_table, say
from labrig.errors import PictureError
from labrig.text import interval, number

Row = dict[str, Any]
ImagesArgument = Annotated[list[Path], Argument(metavar="IMAGE...", help="Pictures of a needle.")]


def curvature(
    images: ImagesArgument,
    intrinsics: IntrinsicsOption = None,
    plane: PlaneOption = None,
    px_per_mm: PxPerMmOption = None,
    origin_px: OriginOption = None,
    insertion: OptionalInsertion = None,
    needle_diameter_mm: NeedleDiameterOption = DEFAULT_NEEDLE_DIAMETER_MM,
    sheath_diameter_mm: SheathDiameterOption = None,
) -> int:
    """Exit with 0 when every picture has a radius, 1 otherwise, 2 when no picture could be read."""
    from labrig.analysis.pictures import list_not_in_interval
    from labrig.cli.mapping import load_plane_map
    from labrig.protocol.yaml_file import validate_values
    from labrig.vision.curvature import (
        CurvatureMeasurement,
        CurvatureSettings,
        measure_curvature,
        refuse_cut_short,
    )
    from labrig.vision.picture import read_picture

    mapping = load_plane_map(intrinsics, plane, px_per_mm, origin_px, insertion)
    diameters = {"needle_diameter_mm": needle_diameter_mm, "sheath_diameter_mm": sheath_diameter_mm}
    settings = validate_values(diameters, "the options", CurvatureSettings)

    measured: dict[Path, CurvatureMeasurement] = {}

    def describe(found: CurvatureMeasurement) -> Row:
        left_out = list_not_in_interval(mapping, [found.radius_budget_mm])
        return {**found.model_dump(mode="json"), "not_in_interval": list(left_out)}

    def measure(path: Path) -> Row:
        found = measured[path] = measure_curvature(read_picture(path), mapping, settings)
        return describe(found)

    def compare(rows: Sequence[Row]) -> list[Row]:
        film = dict(zip(measured, refuse_cut_short(list(measured.values())), strict=True))
        return [describe(film[path]) if path in film else row for path, row in zip(images, rows, strict=True)]

    def list_cells(row: Row) -> Iterable[str | None]:
        stated = row if row["accepted"] else {}
        yield from (number(stated.get("radius_mm"), 2), interval(stated.get("radius_ci95_mm")))
        yield _name_largest(stated.get("radius_budget_mm"))
        yield from (number(row["arc_length_mm"], 1), _format_pair(row["tip_mm"]))

    heads = ("radius mm", "95 % interval mm", "mostly from", "arc mm", "tip y, z mm")
    return _measure_each(images, measure, heads, list_cells, compare)


def tip(
    images: ImagesArgument,
    template: Annotated[
        Path, Option(metavar="FILE", help="Picture of a tip; a JSON file of the same name is beside it.")
    ],
    heading_deg: Annotated[
        float | None, Option(help="Heading of the needle, within 7 degrees. Default: try all headings.")
    ] = None,
    near_px: Annotated[
        tuple[float, float] | None,
        Option(metavar="U V", help="Place of the tip, within 60 px. Default: search the whole picture."),
    ] = None,
    intrinsics: IntrinsicsOption = None,
    plane: PlaneOption = None,
    px_per_mm: PxPerMmOption = None,
    origin_px: OriginOption = None,
    insertion: OptionalInsertion = None,
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
        row = {**fix.model_dump(mode="json"), "tip_mm": None, "tip_budget_mm": None, "not_in_interval": []}
        if fix.tip_px is not None:
            # Light and roll are not in it: no picture tells by how much they change the look of a tip.
            budget = budget_place(mapping, fix.tip_px, PlaceErrors(fit_mm=TIP_SIGMA_PX * mapping.mm_per_px))
            row["tip_mm"] = mapping.to_mm(np.array([fix.tip_px]))[0].tolist()
            row["tip_budget_mm"] = budget.model_dump()
            row["not_in_interval"] = list(list_not_in_interval(mapping, [budget]))
        return row

    def list_cells(row: Row) -> Iterable[str | None]:
        yield from (_format_pair(row["tip_px"]), _format_pair(row["tip_mm"]))
        yield from (_name_largest(row["tip_budget_mm"]), number(row["score"], 3))

    return _measure_each(images, measure, ("tip u, v px", "tip y, z mm", "mostly from", "score"), list_cells)


def _measure_each(
    images: Sequence[Path],
    measure: Callable[[Path], Row],
    heads: Sequence[str],
    list_cells: Callable[[Row], Iterable[str | None]],
    compare: Callable[[Sequence[Row]], list[Row]] = list,
) -> int:
    """Print a row for each picture; the row of a picture that cannot be used has the reason. Return the exit code.

    `compare` judges the rows beside one another.

    Raises
    ------
    InputError
        When no picture can be used.
    """

    def refuse(_path: Path, error: PictureError) -> Row:
        return {"found": False, "accepted": False, "reason": error.message, "not_in_interval": []}

    measured = compare(use_each(images, measure, refuse))
    keys = dict.fromkeys(key for row in measured for key in row)
    rows = [{"image": str(path), **keys, **row} for path, row in zip(images, measured, strict=True)]
    print_json(rows)
    print_table(("picture", *heads), [[Path(row["image"]).name, *list_cells(row)] for row in rows])
    for row in rows:
        if row["reason"]:
            say(f"{Path(row['image']).name}: {row['reason']}")
    left_out = next((row["not_in_interval"] for row in rows if row["not_in_interval"]), ())
    if left_out:
        say(f"Not in the interval: {', '.join(left_out)}.")
    return 0 if all(row["accepted"] for row in rows) else 1


def _name_largest(document: Mapping[str, float] | None) -> str | None:
    """Return the largest source of error with its standard deviation."""
    from labrig.vision.error_budget import ErrorBudget

    budget = ErrorBudget(**(document or {}))
    if budget.largest is None:
        return None
    return f"{budget.largest} ± {number(getattr(budget, budget.largest), 3)}"


def _format_pair(value: Sequence[float] | None) -> str | None:
    return None if value is None else f"{value[0]:.2f}, {value[1]:.2f}"
