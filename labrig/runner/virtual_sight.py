"""What a camera would say of sheath, tip, shaft, paper and markers of a simulated world, without pictures.

A place is seen where the world's lens shows it, and read by the map of the plane that the rig was calibrated with, as
from a picture. What else is off in pictures is drawn: `SightingErrors` and `ShaftErrors`, which were fitted to runs
of one rig, calibration/rig-simulated.yaml, with its light, noise and template (0.1053 mm per px). What they say of
reading a picture is in pixels; that another camera, light or template is as good as that one is not known.

Along a shaft the error of the width is an Ornstein-Uhlenbeck process; besides, the needle tapers, and looks wider
towards the rim of the picture, and length and end are off.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from labrig.analysis.origin import compare_with_command
from labrig.analysis.result import Point, TrialOrigin
from labrig.errors import MeasurementRefusedError
from labrig.needle.kinematics import FloatArray
from labrig.protocol.sections import Sheath
from labrig.runner.sight import SeenRadius, Sight, TakenPicture
from labrig.runner.virtual_rig import VirtualPhotograph
from labrig.simulation.description import LensDescription
from labrig.simulation.lens import plane_to_pixels, see_points
from labrig.simulation.world import Glance, World
from labrig.steering.tip import TipState
from labrig.steering.tip_search import TipSearched
from labrig.vision.curvature import CurvatureSettings
from labrig.vision.error_budget import PlaceErrors
from labrig.vision.marker import MarkerFix
from labrig.vision.out_of_plane import Perspective
from labrig.vision.plane import PlaneMap
from labrig.vision.plane_check import GridCheck
from labrig.vision.shaft_tip import ShaftTip
from labrig.vision.sheath import SheathPose
from labrig.vision.tip import TipFix, is_off_rim


@dataclass(frozen=True)
class SightingErrors:
    """Errors of places and directions that are measured in pictures, besides those of the map.

    The defaults are of 40 runs of protocols/insertion.yaml on the simulated rig, seeds 700001 to 700040, with 4306
    sightings. They hold for its light, its noise and its template. `fresh_share` and `correlated_mm` are between those
    of the errors along and across, whose autocorrelations are 0.56 and 0.33 at 1 mm and 0.26 and 0.10 at 5 mm:
    correlated ones alone make the heading too sure, and leave the final errors without their largest.
    `python -m tests.benchmarks insertion` compares the ends of virtual insertions with those of whole runs.

    Attributes
    ----------
    along_px, along_sd_px, across_px, across_sd_px : float
        Mean and standard deviation of the tip's place by its template, along the needle and to its left.
    rim_px : float
        What is added along `RIM_MM` from the camera's foot; this grows with the squared distance.
    fresh_share, correlated_mm : float
        Share of these variances that is drawn anew in each picture, and length over which the rest decays to 1/e.
    side_mm, turn_mm : float
        What is added across, towards the side to which the bevel bends: the template shows a tip that is bent to that
        side, so that a straight one is read off by `side_mm`, and `turn_mm` less for each radian that the last
        `TURN_MM` are turned.
    missed_share : float
        Share of pictures in which the tip is not found.
    hidden_mm, hidden_share : float
        Length of needle below which the sheath hides the tip, and the share of pictures in which it does.
    sheath_along_px, sheath_sd_px, sheath_sd_rad : float
        Mean error of the sheath's end along it, the standard deviation along each axis, and that of the heading.
    bend_px, bend_sd_px : float
        Of the end of a shaft bent to one side as in the search for the roll zero: mean towards that side, and standard
        deviation across.
    marker_sd_px : float
        Standard deviation of a marker's corner along each axis, common to its corners.
    """

    along_px: float = 0.361
    along_sd_px: float = 0.116
    across_px: float = -0.0665
    across_sd_px: float = 0.0627
    rim_px: float = 0.247
    fresh_share: float = 0.5
    correlated_mm: float = 5.0
    side_mm: float = 0.046
    turn_mm: float = 0.477
    missed_share: float = 0.001
    hidden_mm: float = 1.0
    hidden_share: float = 0.58
    sheath_along_px: float = 0.057
    sheath_sd_px: float = 0.076
    sheath_sd_rad: float = 0.0008
    bend_px: float = 0.399
    bend_sd_px: float = 0.266
    marker_sd_px: float = 0.05


TURN_MM = 2.0
"""Length of the tip over which its turn counts for `SightingErrors.turn_mm`."""

RIM_MM = 50.0
"""Distance from the camera's foot at which `ShaftErrors.rim` is stated."""

_ROW_MM = 0.1
_END_POINTS = 4


@dataclass(frozen=True)
class ShaftErrors:
    """Errors of a shaft in a picture.

    The default widths and lengths are those of 200 pictures of the simulated rig, with the seeds 7000 to 7199; ends are
    those of the last pictures in 40 runs of protocols/insertion.yaml, with the seeds 700001 to 700040.

    Attributes
    ----------
    width, width_spread : float
        Standard deviation of the width of a row, as a share of it, and that of its logarithm from picture to picture.
    correlated_mm : float
        Length over which the error of the width decays to 1/e.
    taper_sd : float
        Standard deviation of the change of width from end to end that is not depth, as a share of it.
    rim : float
        By how much it looks wider `RIM_MM` from the camera's foot, as a share; this grows with the squared distance.
    length_px, length_sd_px : float
        Of the seen length.
    ends_since_mm, ends_along_px, ends_across_px : tuple of float
        Lengths inserted since the bevel was turned, and the mean error of the end there: along the needle, and towards
        the side to which it bends, interpolated in between: a parabola that is fitted to the last stretch does not
        follow a bend that swings over.
    along_sd_px, across_sd_px : float
        Standard deviations about that.
    told_px : float
        Standard deviation of the end's place along each axis, as the picture tells it.
    """

    width: float = 0.0050
    width_spread: float = 0.24
    correlated_mm: float = 1.27
    taper_sd: float = 0.003
    rim: float = 0.006
    length_px: float = 0.446
    length_sd_px: float = 0.807
    ends_since_mm: tuple[float, ...] = (3.0, 5.4, 6.5, 8.0, 10.0)
    ends_along_px: tuple[float, ...] = (-1.52, -0.665, 0.095, 0.475, 0.285)
    ends_across_px: tuple[float, ...] = (-0.712, 0.095, 0.19, 0.427, 0.285)
    along_sd_px: float = 0.427
    across_sd_px: float = 0.142
    told_px: float = 0.627


def measure_arcs(places_mm: FloatArray) -> FloatArray:
    """Return the seen arc lengths (N,) at the points of a path (N, 2)."""
    return np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(places_mm, axis=0), axis=1))))


def draw_shaft(
    seen: tuple[FloatArray, FloatArray],
    plane: PlaneMap,
    diameter_mm: float,
    since_turn_mm: float,
    noise: np.random.Generator,
) -> ShaftTip:
    """Return a shaft as measured in a picture: `seen` are the places (N, 2) of its path and their scales (N,)."""
    (path_mm, scales), errors, px_mm = seen, ShaftErrors(), plane.mm_per_px
    arcs_mm = measure_arcs(path_mm)
    at_mm = np.arange(0.0, arcs_mm[-1], _ROW_MM)
    places_mm = np.column_stack([np.interp(at_mm, arcs_mm, line) for line in path_mm.T])
    wider = (
        errors.rim * square_distances(places_mm, Perspective.of(plane))
        + noise.normal(0.0, errors.taper_sd) * (at_mm / arcs_mm[-1] - 0.5)
        + _draw_rough(len(at_mm), noise, errors)
    )
    widths_mm = diameter_mm * np.interp(at_mm, arcs_mm, scales) * (1.0 + wider)
    length_mm = float(arcs_mm[-1]) + px_mm * noise.normal(errors.length_px, errors.length_sd_px)
    headings_rad = np.arctan2(*np.diff(path_mm[-_END_POINTS:], axis=0).T)
    means_px = [
        float(np.interp(since_turn_mm, errors.ends_since_mm, means))
        for means in (errors.ends_along_px, errors.ends_across_px)
    ]
    means_px[1] *= math.copysign(1.0, headings_rad[-1] - headings_rad[0])
    along_mm, across_mm = px_mm * noise.normal(means_px, (errors.along_sd_px, errors.across_sd_px))
    tip_mm = _step_off(path_mm[-1], float(headings_rad[-1]), along_mm, across_mm)
    u, v = plane.to_px([tip_mm])[0].tolist()
    return ShaftTip(
        tip_px=(u, v),
        tip_mm=tip_mm,
        heading_rad=float(headings_rad[-1]),
        length_mm=length_mm,
        width_px=float(np.median(widths_mm)) / px_mm,
        centre_line_mm=places_mm,
        arc_mm=at_mm * (length_mm / arcs_mm[-1]),
        widths_mm=widths_mm,
        errors=PlaceErrors(fit_mm=px_mm * errors.told_px),
    )


def _step_off(place_mm: FloatArray, heading_rad: float, along_mm: float, across_mm: float) -> Point:
    """Return the place (y, z) so far along a heading, and to its left."""
    y, z = place_mm.tolist()
    sine, cosine = math.sin(heading_rad), math.cos(heading_rad)
    return y + along_mm * sine + across_mm * cosine, z + along_mm * cosine - across_mm * sine


@dataclass
class WorldSight(Sight):
    """Asks a world what pictures of it show; see `Sight`.

    Attributes
    ----------
    world : World
    plane : PlaneMap
        The map of the rig.
    noise : Generator
        Draws the errors.
    lens : LensDescription or None
        The world's own; None: every place is read where it is, which is all that is known of a bench.
    """

    world: World
    plane: PlaneMap
    noise: np.random.Generator
    lens: LensDescription | None

    def __post_init__(self) -> None:
        self.errors, self._px_mm = SightingErrors(), self.plane.mm_per_px
        self._scatter, self._arc_mm = self.noise.standard_normal(2), 0.0
        self._perspective = Perspective.of(self.plane)

    def find_tip(
        self, taken: TakenPicture, expected: FloatArray, tip: TipState, roll_rad: float
    ) -> TipSearched:
        """Return where the tip is seen."""
        del tip
        position_mm = self.see_tip(_look(taken).glance, roll_rad)
        heading_rad = math.atan2(expected[1, 2], expected[2, 2])
        fix = TipFix(accepted=position_mm is not None, reason=None if position_mm is not None else "not seen")
        return TipSearched(fix, position_mm, (0.0, 0.0), heading_rad, 0.0)

    def see_tip(self, glance: Glance | None, base_rad: float) -> FloatArray | None:
        """Return where the tip is seen (x, y, z), with x 0; None where it is not found.

        `base_rad` is where the base of the bevel stands, from the roll zero.
        """
        errors = self.errors
        found, drawn = self.noise.random(), self.noise.standard_normal((2, 2))
        node = None if glance is None else glance.node_before_tip()
        if glance is None or node is None:
            return None
        before = glance.node_before_tip(TURN_MM)
        assert before is not None
        along, across = self._scatter_on(node.arc_mm, drawn).tolist()
        if found < (errors.hidden_share if node.arc_mm < errors.hidden_mm else errors.missed_share):
            return None
        seen_mm, pixels = self._read(np.array([(node.x_mm, node.y_mm, node.z_mm)]))
        u, v = pixels[0].tolist()
        if self.plane.image_size is not None and not is_off_rim(u, v, self.plane.image_size):
            return None
        turn_rad, side = node.heading_rad - before.heading_rad, -math.cos(base_rad)
        along_px = errors.along_px + errors.along_sd_px * along
        along_px += errors.rim_px * float(square_distances(seen_mm, self._perspective)[0])
        across_mm = self._px_mm * (errors.across_px + errors.across_sd_px * across)
        across_mm += errors.side_mm * side - errors.turn_mm * turn_rad
        return np.array((0.0, *_step_off(seen_mm[0], node.heading_rad, self._px_mm * along_px, across_mm)))

    def find_sheath(self, taken: TakenPicture, sheath: Sheath, trial: int) -> TrialOrigin:
        """Return the pose of the sheath, as measured in a picture."""
        glance, errors = _look(taken).glance, self.errors
        assert glance is not None
        end_mm, before_mm = self.locate(np.array(glance.sheath_mm))[0]
        heading_rad = math.atan2(*(end_mm - before_mm)) + float(self.noise.normal(0.0, errors.sheath_sd_rad))
        off_px = self.noise.normal((0.0, errors.sheath_along_px), errors.sheath_sd_px)
        y, z = (end_mm + self._px_mm * off_px).tolist()
        u, v = self.plane.to_px(np.array([[y, z]]))[0].tolist()
        pose = SheathPose((u, v), (y, z), heading_rad, sheath.diameter_mm)
        return compare_with_command(pose, sheath, taken.positions.linear_mm, trial=trial, frame=taken.frame)

    def find_bend(self, taken: TakenPicture, diameter_mm: float, sheath_diameter_mm: float) -> Point:  # noqa: ARG002
        """Return the end of a needle that is bent to one side of its sheath."""
        glance = _look(taken).glance
        node = None if glance is None else glance.node_before_tip()
        if glance is None or node is None:
            raise MeasurementRefusedError("the needle is inside its sheath", "insert it further")
        (end_mm, sheath_mm), _ = self.locate(
            np.array([(node.x_mm, node.y_mm, node.z_mm), glance.sheath_mm[0]])
        )
        side = math.copysign(1.0, end_mm[0] - sheath_mm[0])
        off_px = side * self.errors.bend_px + float(self.noise.normal(0.0, self.errors.bend_sd_px))
        return float(end_mm[0]) + self._px_mm * off_px, float(end_mm[1])

    def measure_end(
        self,
        taken: TakenPicture,
        diameter_mm: float,
        sheath_diameter_mm: float,  # noqa: ARG002 - of pictures
    ) -> ShaftTip:
        """Return the shaft of a needle; refuse one that has hardly left its sheath."""
        looked = _look(taken)
        points_mm = np.empty((0, 3)) if looked.glance is None else looked.glance.points_mm()
        if len(points_mm) < _END_POINTS:
            raise MeasurementRefusedError("the needle is inside its sheath", "insert it further")
        return draw_shaft(self.locate(points_mm), self.plane, diameter_mm, looked.since_turn_mm, self.noise)

    def measure_radius(self, taken: TakenPicture, settings: CurvatureSettings) -> SeenRadius:  # noqa: ARG002
        """Return the radius that the hole has; how well it is read off is not drawn."""
        glance = _look(taken).glance
        if glance is None or glance.track is None or not math.isfinite(glance.radius_mm):
            return SeenRadius(None, None, "the needle is inside its sheath")
        return SeenRadius(glance.radius_mm, self._px_mm * self.errors.bend_sd_px)

    def check_grid(self, taken: TakenPicture, pitch_mm: float) -> GridCheck:  # noqa: ARG002
        """Return paper that is as it should be: nobody bumps the camera of a world."""
        return GridCheck(1.0, 1.0, 0.0)

    def find_markers(
        self, taken: TakenPicture, dictionary: str, marker_ids: Iterable[int]
    ) -> Sequence[MarkerFix]:
        """Return the corners of the markers that the world has."""
        del taken
        return tuple(self._find_marker(marker_id, dictionary) for marker_id in marker_ids)

    def _find_marker(self, marker_id: int, dictionary: str) -> MarkerFix:
        found = self.world.locate_markers().get(marker_id)
        if found is None or found[0].dictionary != dictionary:
            return MarkerFix(marker_id, None, "it was not found")
        marker, moved_mm = found
        half_mm, turn = marker.side_mm / 2, math.radians(marker.turn_deg)
        corners = np.array(
            [(-half_mm, half_mm), (half_mm, half_mm), (half_mm, -half_mm), (-half_mm, -half_mm)]
        )
        along, up = corners.T
        z = marker.position_mm[1] + moved_mm[1] + along * math.cos(turn) - up * math.sin(turn)
        y = marker.position_mm[0] + moved_mm[0] + along * math.sin(turn) + up * math.cos(turn)
        _, pixels = self._read(np.column_stack((np.full(4, marker.x_mm), y, z)))
        return MarkerFix(marker_id, pixels + self.noise.normal(0.0, self.errors.marker_sd_px, 2))

    def locate(self, points_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where points in space (N, 3) are read by the map (N, 2), as (y, z), and their scales (N,)."""
        if self.lens is None:
            return points_mm[:, 1:], np.ones(len(points_mm))
        return locate_points(points_mm, self.lens, self.plane)

    def _read(self, points_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where points in space (N, 3) are read (N, 2), and their pixels (N, 2)."""
        if self.lens is None:
            return points_mm[:, 1:], self.plane.to_px(points_mm[:, 1:])
        pixels = plane_to_pixels(see_points(points_mm, self.lens)[0], self.lens)
        return self.plane.to_mm(pixels), pixels

    def _scatter_on(self, arc_mm: float, drawn: FloatArray) -> FloatArray:
        """Return what scatters at a length of the path, (2,): an Ornstein-Uhlenbeck process, and noise beside it."""
        kept = math.exp(-abs(arc_mm - self._arc_mm) / self.errors.correlated_mm)
        self._scatter = kept * self._scatter + math.sqrt(1.0 - kept**2) * drawn[0]
        self._arc_mm = arc_mm
        fresh = self.errors.fresh_share
        return np.asarray(math.sqrt(1.0 - fresh) * self._scatter + math.sqrt(fresh) * drawn[1])


def _look(taken: TakenPicture) -> VirtualPhotograph:
    assert isinstance(taken.photograph, VirtualPhotograph)
    return taken.photograph


def locate_points(
    points_mm: FloatArray, lens: LensDescription, plane: PlaneMap
) -> tuple[FloatArray, FloatArray]:
    """Return where points in space (N, 3) are read by a map of the plane (N, 2), as (y, z), and their scales (N,)."""
    flat_mm, scales = see_points(points_mm, lens)
    return plane.to_mm(plane_to_pixels(flat_mm, lens)), scales


def square_distances(places_mm: FloatArray, perspective: Perspective | None) -> FloatArray:
    """Return the squares of the distances of places (N, 2) from the camera's foot over that of `RIM_MM`, (N,)."""
    if perspective is None:
        return np.zeros(len(places_mm))
    return np.asarray(np.sum((places_mm - perspective.foot_mm) ** 2, axis=1) / RIM_MM**2)


def _draw_rough(rows: int, noise: np.random.Generator, errors: ShaftErrors) -> FloatArray:
    """Return the errors of the widths of rows, (rows,)."""
    sd = errors.width * math.exp(errors.width_spread * noise.standard_normal())
    kept = math.exp(-_ROW_MM / errors.correlated_mm)
    drawn = noise.standard_normal(rows) * sd * math.sqrt(1.0 - kept**2)
    drawn[0] = sd * noise.standard_normal()
    return np.array(list(accumulate(drawn.tolist(), lambda value, fresh: kept * value + fresh)))
