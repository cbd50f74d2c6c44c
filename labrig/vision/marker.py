"""Markers: printed squares of a dictionary of OpenCV (ArUco, AprilTag), found in a picture by their bits.

What is measured is the place of a marker's centre: that of its four corners, mapped to the plane one by one, so that
neither lens nor perspective displaces it. A marker that is not in the plane is seen enlarged or reduced; where its
distance from the plane is stated that is undone.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import InputError
from labrig.vision.out_of_plane import Perspective
from labrig.vision.picture import Picture, as_grey
from labrig.vision.plane import PlaneMap

FloatArray = NDArray[np.float64]

# Border of a marker around its bits, on each side, in bits.
_BORDER_BITS = 1


@dataclass(frozen=True, eq=False)
class MarkerFix:
    """A marker in a picture: its corners (4, 2) as (u, v) [px], in order; None with the reason if it was not found."""

    marker_id: int
    corners_px: FloatArray | None
    reason: str | None = None


@dataclass(frozen=True)
class MarkerPlace:
    """Where a marker's centre is along the steering plane, (y, z), and how long its sides are [mm]."""

    centre_mm: tuple[float, float]
    side_mm: float


def load_dictionary(name: str) -> cv2.aruco.Dictionary:
    """Return a dictionary of markers by OpenCV's name, for example "DICT_4X4_50".

    Raises
    ------
    InputError
        When there is none of this name.
    """
    number = getattr(cv2.aruco, name, None)
    if not name.startswith("DICT_") or number is None:
        raise InputError(f"there is no dictionary {name!r}", "for example DICT_5X5_100")
    return cv2.aruco.getPredefinedDictionary(number)


def count_markers(name: str) -> int:
    """Return how many markers a dictionary has; their ids count from 0. Raises as `load_dictionary`."""
    return len(load_dictionary(name).bytesList)


def count_bits(name: str) -> int:
    """Return how many bits a marker has along a side, its black border included. Raises as `load_dictionary`."""
    return int(load_dictionary(name).markerSize) + 2 * _BORDER_BITS


def find_markers(image: Picture, dictionary: str, marker_ids: Iterable[int]) -> tuple[MarkerFix, ...]:
    """Find markers in a picture as the camera took it, by their ids; `dictionary` is OpenCV's name of their dictionary.

    A marker that is seen more than once counts as not found. Raises as `load_dictionary`.
    """
    setting = cv2.aruco.DetectorParameters()
    setting.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    setting.markerBorderBits = _BORDER_BITS
    corners, numbers, _ = cv2.aruco.ArucoDetector(load_dictionary(dictionary), setting).detectMarkers(
        as_grey(image)
    )
    seen: dict[int, list[FloatArray]] = {}
    for number, quad in zip([] if numbers is None else np.ravel(numbers), corners, strict=True):
        seen.setdefault(int(number), []).append(np.asarray(quad, dtype=np.float64).reshape(4, 2))
    return tuple(_choose(marker_id, seen.get(marker_id, [])) for marker_id in marker_ids)


def _choose(marker_id: int, places: Sequence[FloatArray]) -> MarkerFix:
    if len(places) == 1:
        return MarkerFix(marker_id, places[0])
    return MarkerFix(marker_id, None, f"it was seen {len(places)} times" if places else "it was not found")


def locate_marker(corners_px: FloatArray, plane: PlaneMap, x_mm: float = 0.0) -> MarkerPlace:
    """Return where a marker is whose corners (4, 2) are seen at these pixels.

    `x_mm` is its distance from the plane, positive away from the camera; where the map does not know the camera's place
    it has to be 0.

    Raises
    ------
    InputError
        For a marker beside a plane without perspective.
    """
    seen_mm = plane.to_mm(corners_px)
    if x_mm != 0.0:
        perspective = Perspective.of(plane)
        if perspective is None:
            raise InputError(
                f"the marker lies {x_mm:g} mm from the plane, and the plane map does not know where the camera stands",
                "calibrate the camera's intrinsics, or put the marker into the plane",
            )
        seen_mm = np.array([place + x_mm * perspective.find_slope(place) for place in seen_mm])
    y, z = seen_mm.mean(axis=0).tolist()
    sides_mm = np.linalg.norm(seen_mm - np.roll(seen_mm, 1, axis=0), axis=1)
    return MarkerPlace((y, z), float(sides_mm.mean()))
