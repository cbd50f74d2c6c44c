"""What a procedure sees: tip, sheath, end, shaft, grid and markers in a picture that it has taken.

`Sight` reads them from the pixels by the rig's calibration, with the functions that the analysis uses. On a rig without
a camera the world is asked instead (`labrig.runner.virtual_sight`).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from labrig.analysis.origin import find_sheath
from labrig.analysis.result import Point, TrialOrigin
from labrig.devices.axis_positions import AxisPositions
from labrig.devices.rig_calls import Photograph
from labrig.devices.rig_file import RigDescription
from labrig.errors import CameraError, InputError, MeasurementRefusedError
from labrig.protocol.sections import Sheath
from labrig.steering.tip import TipState
from labrig.steering.tip_search import TipSearched, TipView, find_tip
from labrig.vision.calibration_file import load_intrinsics, load_plane
from labrig.vision.curvature import CurvatureSettings, measure_curvature
from labrig.vision.marker import MarkerFix, find_markers
from labrig.vision.picture import Picture, load_mask
from labrig.vision.plane import PlaneMap
from labrig.vision.plane_check import GridCheck, check_grid
from labrig.vision.shaft_tip import ShaftTip, measure_shaft_tip
from labrig.vision.template import TipTemplate, load_template

FloatArray = NDArray[np.float64]

_DARKEST_GREY = 12.0


@dataclass(frozen=True, eq=False)
class TakenPicture:
    """A recorded picture: its number, and what the rig gave."""

    frame: int
    photograph: Photograph

    @cached_property
    def image(self) -> Picture:
        """The picture, (H, W) or (H, W, 3) uint8."""
        return self.photograph.read()

    @property
    def positions(self) -> AxisPositions:
        """The axis positions at its exposure."""
        return self.photograph.positions


@dataclass(frozen=True)
class SeenRadius:
    """A radius of curvature and its standard deviation [mm]; None with the reason where none is accepted."""

    radius_mm: float | None
    sd_mm: float | None
    reason: str = ""


class Sight:
    """What can be seen in a picture, by the calibration files of a rig; places are (y, z) in the steering plane [mm].

    `finds_tip` says whether the tip is searched for, which takes a template. What a picture does not show raises
    `MeasurementRefusedError`, unless the result says so.

    Raises
    ------
    InputError
        When the rig names no map of the plane or no template, or a file cannot be read.
    """

    plane: PlaneMap
    """The map from pixels to the steering plane."""

    def __init__(self, rig: RigDescription, *, finds_tip: bool = False) -> None:
        self.plane = load_plane_map(rig)
        mask = rig.calibration_file("mask")
        self._mask = None if mask is None else load_mask(mask)
        self._template = load_tip_template(rig, self.plane) if finds_tip else None

    def find_tip(
        self, taken: TakenPicture, expected: FloatArray, tip: TipState, roll_rad: float
    ) -> TipSearched:
        """Find the needle's tip near a predicted pose (4, 4); `roll_rad` is that of the bevel. See `find_tip`.

        Raises `CameraError` for a dark picture.
        """
        assert self._template is not None, "the sight was opened without a template of the tip"
        require_light(taken.image)
        return find_tip(TipView(self.plane, self._template, self._mask), taken.image, expected, tip, roll_rad)

    def find_sheath(self, taken: TakenPicture, sheath: Sheath, trial: int) -> TrialOrigin:
        """Return the pose of a sheath that nothing has left yet, compared with its command.

        Raises `CameraError` for a dark picture.
        """
        require_light(taken.image)
        linear_mm = taken.positions.linear_mm
        return find_sheath(taken.image, self.plane, sheath, linear_mm, trial=trial, frame=taken.frame)

    def find_bend(self, taken: TakenPicture, diameter_mm: float, sheath_diameter_mm: float) -> Point:
        """Return the end of a needle that bends to one side, by the circle through its shaft."""
        settings = CurvatureSettings(needle_diameter_mm=diameter_mm, sheath_diameter_mm=sheath_diameter_mm)
        measured = measure_curvature(taken.image, self.plane, settings, mask=self._mask)
        if measured.tip_mm is None:
            raise MeasurementRefusedError(
                f"picture {taken.frame} does not show the needle: {measured.reason}",
                "look at it, mend the light",
            )
        return measured.tip_mm

    def measure_end(self, taken: TakenPicture, diameter_mm: float, sheath_diameter_mm: float) -> ShaftTip:
        """Return the shaft of a needle and where it ends."""
        return measure_shaft_tip(taken.image, self.plane, diameter_mm, sheath_diameter_mm, mask=self._mask)

    def measure_radius(self, taken: TakenPicture, settings: CurvatureSettings) -> SeenRadius:
        """Return the radius of curvature of a needle, as the analysis measures it."""
        found = measure_curvature(taken.image, self.plane, settings, mask=self._mask)
        if not found.accepted:
            return SeenRadius(None, None, found.reason or "")
        return SeenRadius(found.radius_mm, found.sigma_radius_mm)

    def check_grid(self, taken: TakenPicture, pitch_mm: float) -> GridCheck:
        """Measure ruled paper. Raises `CalibrationRefusedError`."""
        return check_grid(taken.image, self.plane, pitch_mm)

    def find_markers(
        self, taken: TakenPicture, dictionary: str, marker_ids: Iterable[int]
    ) -> Sequence[MarkerFix]:
        """Find printed markers by their ids. Raises `CameraError` for a dark picture."""
        require_light(taken.image)
        return find_markers(taken.image, dictionary, marker_ids)


def load_tip_template(rig: RigDescription, plane: PlaneMap) -> TipTemplate:
    """Return the template of the tip from a rig's calibration files. Raises `InputError` when it names none."""
    template = rig.calibration_file("template")
    if template is None:
        raise InputError(
            "the rig file names no template of the tip",
            "labrig calibrate template makes one; see calibration:",
        )
    return load_template(template).relative_to(plane.insertion)


def load_plane_map(rig: RigDescription) -> PlaneMap:
    """Return the plane map of a rig from its calibration files.

    Raises
    ------
    InputError
        When the rig has none, or it cannot be read.
    """
    plane, lens = rig.calibration_file("plane"), rig.calibration_file("intrinsics")
    if plane is None:
        raise InputError("the rig file names no plane", "labrig run protocols/calibration.yaml finds it")
    return load_plane(plane, None if lens is None else load_intrinsics(lens))


def require_light(image: Picture) -> None:
    """Refuse a picture that is too dark to show anything.

    Raises
    ------
    CameraError
        For a dark picture, with its mean and the limit.
    """
    mean = float(image.mean())
    if mean < _DARKEST_GREY:
        raise CameraError(
            f"the picture is dark: its mean is {mean:.1f} of 255, and {_DARKEST_GREY:g} is the least",
            "check the light and the lens cap; then take the needle out with labrig devices withdraw",
        )
