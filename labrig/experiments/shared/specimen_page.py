"""The section of a page about each specimen that has a file: what it is, its tracks, the next hole, and its drift."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from labrig.experiments.shared.specimen_figure import draw_curvatures
from labrig.experiments.shared.specimen_result import MOST_CHANGE_PERCENT, SpecimenMap, describe_trend
from labrig.protocol.sections import TrackedSpecimen
from labrig.protocol.specimen_file import SpecimenFile
from labrig.report.formatting import Rows


@dataclass(frozen=True)
class SpecimenView:
    """A specimen on a page; `drifts` and `steady` say in a sentence each what its trends are."""

    map: SpecimenMap
    facts: Rows
    curvatures: Markup | None
    drifts: tuple[str, ...]
    steady: tuple[str, ...]
    most_change_percent: float = MOST_CHANGE_PERCENT


def make_specimen_views(
    maps: Sequence[SpecimenMap], gels: Mapping[str, TrackedSpecimen]
) -> list[SpecimenView]:
    """Return the section of each specimen, with all figures drawn.

    Parameters
    ----------
    gels : mapping of str to TrackedSpecimen
        Those of the protocol, by their key.
    """
    return [
        SpecimenView(
            map=specimen,
            facts=list_specimen_facts(section),
            curvatures=draw_curvatures(specimen, f"drift-{place}"),
            drifts=tuple(describe_trend(trend) for trend in specimen.trends if trend.drifts),
            steady=tuple(describe_trend(trend) for trend in specimen.trends if not trend.drifts),
        )
        for place, specimen in enumerate(maps)
        if (section := gels[specimen.key].block) is not None
    ]


def list_specimen_facts(specimen: SpecimenFile) -> Rows:
    """Return what a specimen file says, term by term, without what it leaves open."""
    index = (
        None
        if specimen.refractive_index is None
        else f"{specimen.refractive_index:g}"
        + ("" if specimen.refractive_index_sd is None else f" (SD {specimen.refractive_index_sd:g})")
    )
    rows = (
        ("Gelatin", f"{specimen.gelatin_percent:g} %"),
        ("Batch", specimen.batch or None),
        ("Mixed", specimen.mixed_on),
        ("Cast", specimen.cast_on),
        ("Cures", specimen.describe_curing()),
        ("Usable until", specimen.usable_until),
        ("Temperature in use", _format(specimen.temperature_celsius, "°C")),
        ("Refractive index", index),
        ("Length", _format(specimen.length_mm, "mm")),
        ("Width", _format(specimen.width_mm, "mm")),
        ("Height", _format(specimen.height_mm, "mm")),
        ("Notes", specimen.notes or None),
    )
    return tuple((term, value) for term, value in rows if value is not None)


def _format(value: float | None, unit: str) -> str | None:
    return None if value is None else f"{value:g} {unit}"
