"""Markers: printed squares of a dictionary of OpenCV (ArUco, AprilTag), found in a picture by their bits.

A marker is searched around where it was last seen, and in the whole picture if it is not there. What is measured is the
place of its centre: that of its four corners, mapped to the plane one by one, so that neither lens nor perspective
displaces it. A marker that is not in the plane is seen enlarged or reduced; where its distance from the plane is stated
that is undone.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.errors import InputError
from labrig.vision.boards import load_dictionary
from labrig.vision.out_of_plane import Perspective
from labrig.vision.picture import Picture, as_grey, size_of
from labrig.vision.plane import PlaneMap

FloatArray = NDArray[np.float64]

# Around where it was last seen a marker is searched this many of its sides to each side.
_REACH_SIDES = 1.5
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


def count_markers(name: str) -> int:
    """Return how many markers a dictionary has; their ids count from 0. Raises as `load_dictionary`."""
    return len(load_dictionary(name).bytesList)


def count_bits(name: str) -> int:
    """Return how many bits a marker has along a side, its black border included. Raises as `load_dictionary`."""
    return int(load_dictionary(name).markerSize) + 2 * _BORDER_BITS


def find_markers(
    image: Picture, dictionary: str, last_px: Mapping[int, FloatArray | None]
) -> tuple[MarkerFix, ...]:
    """Find markers in a picture.

    Parameters
    ----------
    image : Picture
        As the camera took it.
    dictionary : str
        OpenCV's name of the markers' dictionary.
    last_px : mapping of int to (4, 2) array or None
        For each marker to find, by its id, the corners where it was last seen; None: nowhere yet.

    Returns
    -------
    tuple of MarkerFix
        In the order of `last_px`. A marker that is seen more than once where it was searched counts as not found.

    Raises
    ------
    InputError
        For an unknown dictionary.
    """
    grey, detector = as_grey(image), _make_detector(dictionary)
    found: dict[int, MarkerFix] = {}
    for marker_id, corners_px in last_px.items():
        if corners_px is not None:
            fix = _search(grey, detector, [marker_id], _frame_window(grey, corners_px))[marker_id]
            if fix.corners_px is not None:
                found[marker_id] = fix
    lost = [marker_id for marker_id in last_px if marker_id not in found]
    if lost:
        found |= _search(grey, detector, lost, (slice(None), slice(None)))
    return tuple(found[marker_id] for marker_id in last_px)


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


def _make_detector(dictionary: str) -> cv2.aruco.ArucoDetector:
    setting = cv2.aruco.DetectorParameters()
    setting.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    setting.markerBorderBits = _BORDER_BITS
    return cv2.aruco.ArucoDetector(load_dictionary(dictionary), setting)


def _frame_window(grey: Picture, corners_px: FloatArray) -> tuple[slice, slice]:
    """Return the rows and columns around corners in which a marker is searched."""
    low, high = corners_px.min(axis=0), corners_px.max(axis=0)
    reach_px = _REACH_SIDES * float((high - low).max())
    width, height = size_of(grey)
    left, top = (int(max(0.0, edge)) for edge in low - reach_px)
    right, bottom = (
        int(min(size, edge)) for size, edge in zip((width, height), high + reach_px, strict=True)
    )
    return slice(top, max(bottom, top + 1)), slice(left, max(right, left + 1))


def _search(
    grey: Picture, detector: cv2.aruco.ArucoDetector, wanted: Sequence[int], window: tuple[slice, slice]
) -> dict[int, MarkerFix]:
    """Find markers by their ids in a part of a picture."""
    part = np.ascontiguousarray(grey[window])
    corners, numbers, _ = detector.detectMarkers(part)
    offset = np.array([window[1].start or 0, window[0].start or 0], dtype=float)
    seen = [] if numbers is None else [int(number) for number in np.ravel(numbers)]
    places = [np.asarray(quad, dtype=np.float64).reshape(4, 2) + offset for quad in corners]
    return {marker_id: _choose(marker_id, seen, places) for marker_id in wanted}


def _choose(marker_id: int, seen: Sequence[int], places: Iterable[FloatArray]) -> MarkerFix:
    count = Counter(seen)[marker_id]
    if count != 1:
        return MarkerFix(marker_id, None, "it was not found" if count == 0 else f"it was seen {count} times")
    return MarkerFix(
        marker_id, next(place for number, place in zip(seen, places, strict=True) if number == marker_id)
    )
