"""Whether a plane map has the scale of the last one of the same camera.

No residual shows a wrong multiple, and a sheet without heavier lines does not contradict one (see `pitch_check`). An
earlier map of the camera does. So both scales are always stated, and a scale that other lines of the paper could
explain is refused until a person says that the camera was moved. Such a map replaces no file before, not even as a
refused one: the next map would be compared with it.
"""

from dataclasses import dataclass, replace
from datetime import datetime

from labrig.vision.plane import PlaneMap

# A camera that was not moved keeps its scale within this: printed paper is true to 0.5 %, and paper 5 mm higher or
# lower under a camera 500 mm away is 1 % off.
_SAME = 0.02
# The lines of common papers differ by a factor of 1.27 or more: every twentieth of an inch for every millimetre, and
# every 2, 5 or 10 mm. A wrong count that a shifted camera hides in part is above this as well.
_OTHER_LINES = 1.2
_ADVICE = (
    " If neither the camera nor its lens nor the height of the paper was changed since, one of the two is wrong: "
    "measure the lines of the paper and the width of the picture with a ruler."
)


@dataclass(frozen=True)
class PlaneScale:
    """The scale of a plane map in a file.

    Attributes
    ----------
    file : str
    created : datetime or None
    accepted : bool
    mm_per_px : float
        At `origin_px`.
    origin_px : (float, float)
    image_size : (int, int) or None
        Width and height of the pictures that the map is for [px].
    """

    file: str
    created: datetime | None
    accepted: bool
    mm_per_px: float
    origin_px: tuple[float, float]
    image_size: tuple[int, int] | None

    def name(self) -> str:
        """Return the map's file, when it was made, and whether it was refused."""
        made = "" if self.created is None else f" of {self.created:%Y-%m-%d}"
        return f"{self.file}{made}{'' if self.accepted else ' (refused)'}"


@dataclass(frozen=True)
class ScaleComparison:
    """The scale of a plane map and that of the last one of the same camera.

    Attributes
    ----------
    last : str
        The last map: its file, when it was made, and whether it was refused.
    sentence : str
        The comparison in words.
    mm_per_px, last_mm_per_px, ratio : float or None
        Both scales at the origin of the last map, and the first over the second; None if they cannot be compared.
    needs_confirmation : bool
        Other lines of the paper could explain the ratio, and nobody said that the camera was moved.
    """

    last: str
    sentence: str
    mm_per_px: float | None = None
    last_mm_per_px: float | None = None
    ratio: float | None = None
    needs_confirmation: bool = False


def compare_scales(plane: PlaneMap, last: PlaneScale, *, camera_moved: bool) -> ScaleComparison:
    """Compare the scale of a plane map with that of the last one.

    Parameters
    ----------
    camera_moved : bool
        A person says that the camera, its lens or the height of the paper was changed since.
    """
    obstacle = _find_obstacle(plane, last)
    if obstacle is not None:
        sentence = f"The scale is not compared with that of the last plane map, {last.name()}: {obstacle}."
        return ScaleComparison(last.name(), sentence)
    scale = plane.mm_per_px_at(last.origin_px)
    ratio = scale / last.mm_per_px
    needs_confirmation = max(ratio, 1.0 / ratio) > _OTHER_LINES and not camera_moved
    u, v = last.origin_px
    sentence = (
        f"The scale is {scale:.5f} mm/px at ({u:.0f}, {v:.0f}) px, {ratio:.3f} times the {last.mm_per_px:.5f} mm/px of "
        f"the last plane map, {last.name()}"
    )
    changed = abs(ratio - 1.0) > _SAME
    if changed and plane.picture_mm is not None:
        sentence += f", by which the picture is {plane.picture_mm[0] / ratio:.0f} mm wide"
    advice = _ADVICE if changed and not camera_moved and not needs_confirmation else ""
    return ScaleComparison(
        last.name(), f"{sentence}.{advice}", scale, last.mm_per_px, ratio, needs_confirmation
    )


def refuse_other_scale(plane: PlaneMap, comparison: ScaleComparison, confirmation: str) -> PlaneMap:
    """Return the map, refused if its scale needs a person's confirmation.

    Parameters
    ----------
    confirmation : str
        How a person confirms that the camera was moved.
    """
    if not comparison.needs_confirmation:
        return plane
    reason = (
        f"the scale is {comparison.ratio:.3f} times that of the last plane map, {comparison.last} "
        f"({comparison.mm_per_px:.5f} and {comparison.last_mm_per_px:.5f} mm/px), as if other lines of the paper had "
        "been counted: measure the lines of the paper and the width of the picture with a ruler; if the camera, its "
        f"lens or the height of the paper was changed, {confirmation}"
    )
    return replace(plane, accepted=False, reasons=(*plane.reasons, reason))


def _find_obstacle(plane: PlaneMap, last: PlaneScale) -> str | None:
    """Return why two scales cannot be compared."""
    if plane.image_size is not None and last.image_size is not None and plane.image_size != last.image_size:
        (width, height), (other_width, other_height) = plane.image_size, last.image_size
        return f"that map is for pictures of {other_width} x {other_height} pixels, this one has {width} x {height}"
    return None
