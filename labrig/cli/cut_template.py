"""Cuts a tip template out of a recorded frame or a picture, for `labrig calibrate template`."""

from dataclasses import dataclass
from pathlib import Path

from labrig.analysis.calibration import load_plane_map
from labrig.cli.options import DEFAULT_NEEDLE_DIAMETER_MM
from labrig.errors import InputError
from labrig.experiments.registry import load_run_protocol
from labrig.experiments.shared.needle_events import NeedleRole
from labrig.record.reader import open_run
from labrig.vision.picture import Picture, read_picture
from labrig.vision.plane import Insertion, PlaneMap
from labrig.vision.shaft_tip import ShaftTip, measure_shaft_tip
from labrig.vision.tip_template import TipTemplate, cut_template

# Needle widths that a template shows to each side of the tip, and its side if no shaft was measured.
_WIDTHS, _SIDE_PX = 1.75, 41


@dataclass(frozen=True)
class TipSource:
    """A picture with its map to mm, the roll of the bevel, and the diameters of needle and sheath."""

    file: Path
    image: Picture
    plane: PlaneMap | None
    roll_rad: float
    needle_diameter_mm: float
    sheath_diameter_mm: float | None

    def measure_tip(self) -> ShaftTip:
        """Measure tip and heading by the shaft."""
        if self.plane is None:
            raise InputError(
                "tip and heading cannot both be measured: it is not known how the picture maps to mm",
                "give --tip-px and --heading-deg, or the map: --intrinsics and --plane, or --px-per-mm",
            )
        return measure_shaft_tip(self.image, self.plane, self.needle_diameter_mm, self.sheath_diameter_mm)


def read_recorded_frame(folder: Path, frame: int | None) -> TipSource:
    """Return a frame of a run, by default the last frame of a needle, with what the record says of it.

    Raises
    ------
    InputError
        When the run holds no such picture, or no map of its pictures to mm.
    RecordError
        When the picture or the record is damaged.
    """
    run = open_run(folder)
    if frame is None:
        shown = [line.frame for line in run.frame_lines if line.role in set(NeedleRole)]
        if not shown:
            raise InputError(f"{folder} holds no picture of a needle", "name one with --frame")
        frame = shown[-1]
    image, line = run.read_frame(frame), run.frame_lines[frame]
    needle = load_run_protocol(run).pictured_needle
    return TipSource(
        folder / line.file,
        image,
        load_plane_map(run),
        line.rotation_rad or 0.0,
        DEFAULT_NEEDLE_DIAMETER_MM if needle is None else needle.diameter_mm,
        None if needle is None else needle.sheath_diameter_mm,
    )


def read_single_picture(picture: Path) -> TipSource:
    """Return a picture of which nothing else is known. Raises `PictureError`."""
    return TipSource(picture, read_picture(picture), None, 0.0, DEFAULT_NEEDLE_DIAMETER_MM, None)


def cut_tip(
    found: TipSource,
    tip_px: tuple[float, float] | None,
    heading_rad: float | None,
    side_px: int | None,
    insertion: Insertion,
) -> TipTemplate:
    """Return the template; tip and heading that are not given are measured by the shaft.

    Raises
    ------
    InputError, PictureError
        When a value is missing or impossible; the message names it.
    MeasurementRefusedError
        When the picture does not show one shaft.
    """
    if tip_px is None or heading_rad is None:
        shaft = found.measure_tip()
        tip_px = tip_px or shaft.tip_px
        heading_rad = shaft.heading_rad if heading_rad is None else heading_rad
        side_px = side_px or 2 * round(_WIDTHS * shaft.width_px) + 1
    points = insertion if found.plane is None else found.plane.insertion
    return cut_template(
        found.image,
        tip_px,
        heading_rad,
        side_px=side_px or _SIDE_PX,
        insertion=points,
        roll_rad=found.roll_rad,
    )
