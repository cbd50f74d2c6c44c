"""Our own contour of a hinge as polygons, because figure 2 of the paper is not in its text.

**In the view along the pin** (hinge a in the plane in which the needle bends) the lower link ends in a round
knuckle that lies in a socket of the upper one. The pin is the origin, x lateral, z along the needle::

       |    socket link    |
       |     .-------.     |
       |   (           )   |
       |  (   knuckle   )  |   the lips of the socket reach under the knuckle
        `-._ `.     .' _.-'    stop faces, inclined by beta_cut from the square drawn line
       ______ |     | ______   shoulders of the knuckle link, square; the neck between them
       |    knuckle link   |

What is decided:

- The knuckle is drawn as wide as the bore, with radius R = D_i / 2, so that the cut passes through the whole wall.
- The neck is drawn with width R: the lips reach round the knuckle to 30 degrees from the axis.
- The stop faces of the socket link are drawn square to the axis at the height of the lips, then turned about the
  pin by beta_cut, to both sides. So for d -> 0 hinge a turns by exactly beta_cut. The turn shortens the lips.
- The drawn line is the edge of the socket link before that turn, and the laser removes d beside it: the knuckle
  link is everything at a distance of at least d.

R and the neck are round numbers, not fits; the text gives neither. They matter: lips to 25 degrees give a
plane of 1.08, 326 and -0.55 (RMSE 0.10), lips to 35 degrees 1.13, 361 and -0.84 (0.16), and a knuckle of 0.45 mm
with lips to 30 degrees 1.09, 327 and -0.57 (0.11).

**In the view square to the pin** (hinge b in the same plane) the two walls of the tube are seen edge-on. A
motion in this plane maps every section parallel to it onto itself, so the links are free if they are free in
every such section. Two sections decide: the section through the axis, where the knuckle is nearest to the
socket's crown, and the section just inside a lip, where the socket is nearest to the knuckle's underside. They
are cut from the view along the pin, as if the laser cut along the pin. In fact it cuts towards the axis, and the
tapered pieces hold each other along the pin. The model keeps only this effect of the taper (`SearchBox.lateral_mm`).

These are side views and not the unrolled surface, because the lever arms are those of the side view.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from shapely import LineString, MultiPolygon, Polygon

from labrig.errors import InputError
from labrig.needle.kinematics import FloatArray
from labrig.needle.limits import require_within
from labrig.protocol.design_file import Tube

_NECK_HALF_ANGLE_RAD = math.radians(30.0)
# Chords of an arc. With 120, the sum of both rotations is within 0.01 degrees of the sum with 480.
_CHORDS = 120
_CORNER_CHORDS = 24
# How far inside the lip its section is taken: enough for a polygon, at a cost of 0.0003 degrees.
_INSIDE_LIP_MM = 1e-4
# Thinnest kerf: the waist of a focused laser.
THINNEST_CLEARANCE_MM = 0.001


@dataclass(frozen=True)
class LinkPair:
    """Two links in one plane, at rest: `knuckle` stays, `socket` moves."""

    knuckle: Polygon | MultiPolygon
    socket: Polygon | MultiPolygon


@dataclass(frozen=True)
class SearchBox:
    """The search box: rotation from 0, translations to both sides."""

    rotation_deg: float
    lateral_mm: float
    axial_mm: float


@dataclass(frozen=True)
class HingeView:
    """A hinge in the plane of bending: sections that must stay free of interference, search box, lie of its pin."""

    sections: tuple[LinkPair, ...]
    box: SearchBox
    pin_in_plane: bool


@dataclass(frozen=True)
class Hinge:
    """A hinge cut from a tube by a laser of clearance d (mm) at the inclination beta_cut (degrees).

    Raises
    ------
    InputError
        If the knuckle would slip out of its socket, or the link is too short for a hinge at each end.
    """

    tube: Tube
    clearance_mm: float
    beta_cut_deg: float

    def __post_init__(self) -> None:
        require_within(
            "laser clearance",
            self.clearance_mm,
            (THINNEST_CLEARANCE_MM, widest_clearance_mm(self.tube, 0.0)),
            "a laser cuts no finer, and a wider cut lets the knuckle slip out of its socket",
        )
        # At the steepest the lips reach under the knuckle by no more than a clearance.
        lip_angle_rad = math.asin(1 - 2 * self.clearance_mm / self.knuckle_radius_mm)
        require_within(
            "cutting inclination",
            self.beta_cut_deg,
            (0.0, math.degrees(lip_angle_rad - _NECK_HALF_ANGLE_RAD)),
            f"at a clearance of {self.clearance_mm:g} mm a steeper one cuts the socket's lips through",
            "degrees",
        )
        self._require_room_for_both_ends()

    def _require_room_for_both_ends(self) -> None:
        tube = self.tube
        wall_mm = (tube.outer_diameter_mm - tube.inner_diameter_mm) / 2
        needed_mm = self.knuckle_radius_mm + self.lip_depth_mm + self.clearance_mm + wall_mm
        if tube.link_length_mm < needed_mm:
            raise InputError(
                f"link length is {tube.link_length_mm:g} mm, and has to be at least {needed_mm:.3g} mm: "
                "socket and knuckle at its two ends would meet",
                "take a longer link, or a tube with a smaller bore",
            )

    @property
    def knuckle_radius_mm(self) -> float:
        """Radius of the socket, and of the knuckle before the laser takes d."""
        return self.tube.inner_diameter_mm / 2

    @property
    def lip_depth_mm(self) -> float:
        """Depth of the drawn lips below the pin."""
        return self.knuckle_radius_mm * math.cos(_NECK_HALF_ANGLE_RAD)

    @property
    def lip_half_width_mm(self) -> float:
        """Half the opening between the lips after the cut of beta_cut."""
        return self.knuckle_radius_mm * math.sin(self._lip_angle_rad)

    @property
    def _lip_angle_rad(self) -> float:
        return _NECK_HALF_ANGLE_RAD + math.radians(self.beta_cut_deg)

    @property
    def pull_out_mm(self) -> float:
        """Distance by which the links can be pulled apart along the axis until the knuckle meets both lips."""
        across = self.lip_half_width_mm
        radius = self.knuckle_radius_mm
        return math.sqrt(radius**2 - across**2) - math.sqrt((radius - self.clearance_mm) ** 2 - across**2)

    @cached_property
    def links(self) -> LinkPair:
        """The two links in the view along the pin, at rest, each to the middle of its length."""
        return LinkPair(self._knuckle_link(), self._socket_link())

    def hinge_a(self) -> HingeView:
        """Return the hinge whose pin is square to the plane of bending."""
        play_mm = self.clearance_mm + self.pull_out_mm
        rotation_deg = self.beta_cut_deg + math.degrees(play_mm / (self.tube.outer_diameter_mm / 2))
        box = SearchBox(2 * rotation_deg, 2 * self.pull_out_mm, 2 * self.pull_out_mm)
        return HingeView((self.links,), box, pin_in_plane=False)

    def hinge_b(self) -> HingeView:
        """Return the hinge whose pin lies in the plane of bending.

        Nothing in the plane holds the links along the pin. The laser cuts towards the tube's axis, so the pieces
        taper by R / (D_o / 2) at the knuckle's sides and hold each other after d D_o / (2 R).
        """
        outer_mm = self.tube.outer_diameter_mm / 2
        lever_mm = outer_mm + math.sqrt(outer_mm**2 - self.lip_half_width_mm**2)
        rotation_deg = math.degrees((self.clearance_mm + self.pull_out_mm) / lever_mm)
        lateral_mm = self.clearance_mm * outer_mm / self.knuckle_radius_mm
        sections = tuple(map(self.section, (0.0, self.lip_half_width_mm + _INSIDE_LIP_MM)))
        box = SearchBox(2 * rotation_deg, lateral_mm, 2 * self.pull_out_mm)
        return HingeView(sections, box, pin_in_plane=True)

    def section(self, depth_mm: float) -> LinkPair:
        """Return both links in a plane parallel to the pin, at this distance from the needle's axis."""
        return LinkPair(self._walls(self.links.knuckle, depth_mm), self._walls(self.links.socket, depth_mm))

    def _walls(self, link: Polygon | MultiPolygon, depth_mm: float) -> MultiPolygon:
        """Return the two walls of the tube where the plane cuts this link."""
        inner_mm = math.sqrt(max((self.tube.inner_diameter_mm / 2) ** 2 - depth_mm**2, 0.0))
        outer_mm = math.sqrt((self.tube.outer_diameter_mm / 2) ** 2 - depth_mm**2)
        reach_mm = self.tube.link_length_mm
        cut = shapely.intersection(link, LineString([(depth_mm, -reach_mm), (depth_mm, reach_mm)]))
        bounds = [part.bounds for part in shapely.get_parts(cut) if part.length > 0]
        walls = ((inner_mm, outer_mm), (-outer_mm, -inner_mm))
        return MultiPolygon([shapely.box(a, low, b, high) for _, low, _, high in bounds for a, b in walls])

    def _socket_link(self) -> Polygon:
        outer_mm, top_mm = self.tube.outer_diameter_mm / 2, self.tube.link_length_mm / 2
        cut_rad = math.radians(self.beta_cut_deg)
        face_mm = (outer_mm * math.sin(cut_rad) - self.lip_depth_mm) / math.cos(cut_rad)
        hole = _arc(self.knuckle_radius_mm, self._lip_angle_rad)
        jaws = [(-outer_mm, face_mm), (-outer_mm, top_mm), (outer_mm, top_mm), (outer_mm, face_mm)]
        return Polygon([*hole, *jaws])

    def _knuckle_link(self) -> Polygon:
        outer_mm, bottom_mm = self.tube.outer_diameter_mm / 2, -self.tube.link_length_mm / 2
        shoulder_mm = -self.lip_depth_mm - self.clearance_mm
        knuckle = _arc(self.knuckle_radius_mm - self.clearance_mm, _NECK_HALF_ANGLE_RAD)
        corner = self._neck_corner()
        left = [(-outer_mm, shoulder_mm), (-outer_mm, bottom_mm)]
        right = [(outer_mm, bottom_mm), (outer_mm, shoulder_mm)]
        return Polygon([*knuckle[1:-1], *(corner * (-1, 1)), *left, *right, *corner[::-1]])

    def _neck_corner(self) -> FloatArray:
        """Return the arc at distance d round the drawn right lip, from the knuckle down to the shoulder."""
        direction = [math.sin(_NECK_HALF_ANGLE_RAD), -math.cos(_NECK_HALF_ANGLE_RAD)]
        lip = self.knuckle_radius_mm * np.array(direction)
        angles = np.linspace(math.pi / 2 + _NECK_HALF_ANGLE_RAD, 1.5 * math.pi, _CORNER_CHORDS + 1)
        return lip + self.clearance_mm * _directions(angles)


def widest_clearance_mm(tube: Tube, beta_cut_deg: float) -> float:
    """Return the widest clearance at which the knuckle stays in its socket.

    The lips must reach under the knuckle by a clearance. Along the pin the play must not exceed half the wall, or
    the knuckle slips into the bore.
    """
    lip_angle_rad = _NECK_HALF_ANGLE_RAD + math.radians(beta_cut_deg)
    by_lips_mm = tube.inner_diameter_mm / 4 * (1 - math.sin(lip_angle_rad))
    wall_mm = (tube.outer_diameter_mm - tube.inner_diameter_mm) / 2
    return min(by_lips_mm, wall_mm / 2 * tube.inner_diameter_mm / tube.outer_diameter_mm)


def _arc(radius_mm: float, opening_rad: float) -> FloatArray:
    """Return a circle about the pin without its lowest part: counter-clockwise from the right lip to the left."""
    start = opening_rad - math.pi / 2
    return radius_mm * _directions(np.linspace(start, math.pi - start, _CHORDS + 1))


def _directions(angles: FloatArray | Sequence[float]) -> FloatArray:
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)
