"""Markers in pictures that these tests draw themselves: places, missing and double ones, those beside the plane."""

import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from labrig.errors import InputError
from labrig.vision.marker import count_bits, count_markers, find_markers, locate_marker
from labrig.vision.plane import PlaneMap
from tests.vision.renderer import Camera, Photo

Picture = NDArray[np.uint8]
CAMERA = Camera(distance_mm=185.0, origin_px=(150.0, 310.0))
PLANE = CAMERA.plane_map()
FINER = 4  # pictures are drawn so many times as large and then reduced


def draw(
    *places: tuple[int, float, float],
    dictionary: str = "DICT_4X4_50",
    side_mm: float = 6.0,
    x_mm: float = 0.0,
    turn_rad: float = 0.3,
) -> Picture:
    """Draw markers (id, y, z) on grey gel, each as the lens shows the corners of its cells."""
    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    sheet = np.full((CAMERA.size[1] * FINER, CAMERA.size[0] * FINER), 150, np.uint8)
    for marker_id, y_mm, z_mm in places:
        cells = np.pad(
            cv2.aruco.generateImageMarker(book, marker_id, count_bits(dictionary)), 1, constant_values=255
        )
        for row, column in np.ndindex(cells.shape):
            corners = [(column + a, row + b) for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))]
            card = (np.array(corners) - len(cells) / 2) * side_mm / count_bits(dictionary)
            along, up = card[:, 0], -card[:, 1]
            y = y_mm + along * math.sin(turn_rad) + up * math.cos(turn_rad)
            z = z_mm + along * math.cos(turn_rad) - up * math.sin(turn_rad)
            shown = (CAMERA.to_px(np.column_stack((z, -y)), x_mm) + 0.5) * FINER - 0.5
            cv2.fillConvexPoly(
                sheet, np.round(shown * 16).astype(np.int32), int(30 + cells[row, column] * 0.7), shift=4
            )
    return Photo(noise=2.0).take(cv2.resize(sheet, CAMERA.size, interpolation=cv2.INTER_AREA).astype(float))


@pytest.mark.processors
@pytest.mark.parametrize("dictionary", ["DICT_4X4_50", "DICT_APRILTAG_36h11"])
def test_a_displacement_is_measured_to_some_hundredths_of_a_millimetre(dictionary: str) -> None:
    """A marker that moves is found, turned and tilted as it is, and its sides have their length."""
    (before,) = find_markers(draw((7, -25.0, 30.0), dictionary=dictionary), dictionary, [7])
    (after,) = find_markers(draw((7, -23.2, 31.1), dictionary=dictionary), dictionary, [7])
    start, end = locate_marker(before.corners_px, PLANE), locate_marker(after.corners_px, PLANE)
    assert start.centre_mm == pytest.approx((-25.0, 30.0), abs=0.03)
    assert np.subtract(end.centre_mm, start.centre_mm) == pytest.approx((1.8, 1.1), abs=0.03)
    assert start.side_mm == pytest.approx(6.0, abs=0.06)


def test_a_marker_that_is_seen_twice_or_never_is_refused_with_the_reason() -> None:
    """Of two markers of one id nothing tells which is bound; one that is not there is not another."""
    picture = draw((7, -25.0, 30.0), (7, 20.0, 60.0), (3, 20.0, 90.0))
    twice, never, once = find_markers(picture, "DICT_4X4_50", [7, 4, 3])
    assert (twice.corners_px, twice.reason) == (None, "it was seen 2 times")
    assert (never.corners_px, never.reason) == (None, "it was not found")
    assert once.corners_px is not None


@pytest.mark.processors
def test_a_marker_beside_the_plane_is_measured_there() -> None:
    """A marker 20 mm before the plane is seen larger, and moving by more; with its x stated both are undone."""
    x_mm = -20.0
    pictures = [draw((7, -20.0, z_mm), x_mm=x_mm) for z_mm in (30.0, 33.0)]
    before, after = (find_markers(picture, "DICT_4X4_50", [7])[0].corners_px for picture in pictures)
    told = [locate_marker(corners, PLANE, x_mm) for corners in (before, after)]
    taken_for_flat = [locate_marker(corners, PLANE) for corners in (before, after)]
    assert told[0].centre_mm == pytest.approx((-20.0, 30.0), abs=0.1)
    assert told[1].centre_mm[1] - told[0].centre_mm[1] == pytest.approx(3.0, abs=0.03)
    assert told[0].side_mm == pytest.approx(6.0, abs=0.06)
    assert taken_for_flat[1].centre_mm[1] - taken_for_flat[0].centre_mm[1] == pytest.approx(3.36, abs=0.03)
    with pytest.raises(InputError, match="does not know where the camera stands"):
        locate_marker(before, PlaneMap.from_scale(10.0, (0.0, 0.0), "right"), x_mm)


def test_dictionaries_say_how_many_markers_and_bits_they_have() -> None:
    """Ids count from 0; the border counts as bits; an unknown name is refused."""
    assert (count_markers("DICT_4X4_50"), count_bits("DICT_4X4_50")) == (50, 6)
    assert (count_markers("DICT_APRILTAG_36h11"), count_bits("DICT_APRILTAG_36h11")) == (587, 8)
    with pytest.raises(InputError, match="there is no dictionary"):
        count_markers("MARKERS")
