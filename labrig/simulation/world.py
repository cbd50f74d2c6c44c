"""The world: the objects on the bench, the effect of the axes on them, and the camera's view of them."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from labrig.errors import InputError
from labrig.simulation.description import PrintedMarkerDescription, WorldDescription, stream
from labrig.simulation.draw import (
    PathSpan,
    blur,
    draw_backdrop,
    draw_gel,
    draw_marker,
    draw_noise_bank,
    draw_with_needle,
    expose,
    print_marker,
)
from labrig.simulation.gel import (
    LAST_POSITION_MM,
    Ball,
    GelBlock,
    Hole,
    cast_specimen,
    make_empty_hole,
    make_hole,
)
from labrig.simulation.lens import Field32, Floats, plane_to_pixels, steering_plane_pose, unproject
from labrig.simulation.targets import (
    Chessboard,
    choose_board_pose,
    draw_board,
    draw_graph_paper,
    draw_light,
)
from labrig.simulation.track import NODE_MM, PathNode, Track, follow_with_play

_Drawn = TypeVar("_Drawn")

SHEATH_MM = 5.0
"""Length of the sheath's end whose direction is seen."""

_PATH_EVERY_MM = 0.5
_STUCK_MM = 0.5  # a deeper instrument would tear the gel when a hand moves it


@dataclass(frozen=True, eq=False)
class Glance:
    """What there was to see of sheath and needle at a moment; the needle's path was cut as far as its tip then.

    `track` is None while the needle is inside the sheath. `sheath_mm` are the sheath's end and a point of its axis
    `SHEATH_MM` before it, (x, y, z); `radius_mm` is that of the hole's arcs.
    """

    track: Track | None
    tip_arc_mm: float
    sheath_mm: tuple[tuple[float, float, float], tuple[float, float, float]]
    radius_mm: float

    def node_before_tip(self, length_mm: float = 0.0) -> PathNode | None:
        """Return the needle's path this far before its tip; None while the needle is inside the sheath."""
        return None if self.track is None else self.track.node_at(self.tip_arc_mm - length_mm)

    def points_mm(self) -> Floats:
        """Return the needle's path (N, 3), from the sheath to its tip."""
        if self.track is None:
            return np.empty((0, 3))
        arcs = np.arange(0.0, self.tip_arc_mm, _PATH_EVERY_MM)
        return np.array([_xyz(self.track.node_at(arc)) for arc in (*arcs, self.tip_arc_mm)])


class World:
    """The simulated bench.

    Parameters
    ----------
    description : WorldDescription
        The `world:` section of the rig file.
    seed : int
        The protocol's seed. Each draw has a stream of its own (specimen; hole and needle; picture of the
        hole), so that no draw depends on earlier actions.

    Raises
    ------
    InputError
        For a marker that its dictionary does not have.
    """

    def __init__(self, description: WorldDescription, seed: int) -> None:
        self.description = description
        self._seed = seed
        self._clamped_rad = math.radians(description.needle.clamp_roll_deg)
        self._insertion_mm, self._base_rad, self._linear_mm = 0.0, self._clamped_rad, 0.0
        self._bevel_rad = self._base_rad
        self._needle_id: str | None = None
        self._target_mm: tuple[float, float, float] | None = None
        self._specimens: dict[tuple[str, float], GelBlock] = {}
        self._specimen: GelBlock | None = None
        self._hole = make_empty_hole()
        self._covering: tuple[str, Callable[[], Field32]] | None = None
        self._drawn: dict[str, tuple[object, Any]] = {}
        self._pictures: dict[str, int] = {}
        for marker in description.markers:
            print_marker(marker)  # refused here, not at the first picture

    # Drawn with the first picture: they take most of the time in which a world is made, and few worlds are looked at.
    @cached_property
    def _white(self) -> Field32:
        light, lens = self.description.light, self.description.lens
        return draw_light(light, lens) * np.float32(light.level)

    @cached_property
    def _noise(self) -> Field32:
        return draw_noise_bank(self.description.lens, stream(self._seed, "noise bank"))

    def mount_needle(self, needle_id: str) -> None:
        """Clamp a needle into the instrument, which starts without a needle; its bevel is not wound up.

        Raises
        ------
        InputError
            While needle or sheath is in a gel; the same holds for every action below that moves the gel.
        """
        self._refuse_if_stuck("the needle is changed")
        self._needle_id = needle_id
        self._bevel_rad = self._base_rad

    def place_specimen(self, name: str, gelatin_percent: float) -> None:
        """Put a specimen before the sheath, fresh or with its earlier tracks.

        Raises
        ------
        InputError
            For a gelatin that the world does not describe.
        """
        self._refuse_if_stuck(f"{name} is placed")
        key = (name, gelatin_percent)
        if key not in self._specimens:
            self._specimens[key] = cast_specimen(self.description, self._seed, name, gelatin_percent)
        self._put_before_sheath(self._specimens[key])

    def place_phantom(self, name: str, gelatin_percent: float, obstacles: Sequence[Ball]) -> None:
        """Put a fresh block with obstacles cast in before the sheath, for one insertion.

        The obstacles are given where the protocol says, besides those that the description marks; it may shift them.

        Raises
        ------
        InputError
            For a gelatin that the world does not describe.
        """
        self._refuse_if_stuck(f"{name} is placed")
        plain = cast_specimen(self.description, self._seed, name, gelatin_percent)
        marked = [
            Ball((0.0, y_mm, z_mm), radius_mm) for y_mm, z_mm, radius_mm in self.description.obstacle_marks_mm
        ]
        cast = self._shift_obstacles(name, (*obstacles, *marked))
        self._put_before_sheath(replace(plain, obstacles=cast, is_phantom=True))

    def _shift_obstacles(self, name: str, obstacles: Sequence[Ball]) -> tuple[Ball, ...]:
        """Return the obstacles where they truly are."""
        random = stream(self._seed, "obstacles", name)
        shifts_mm = self.description.obstacle_shift_sd_mm * random.standard_normal((len(obstacles), 3))
        return tuple(
            Ball(tuple((shift_mm + ball.position_mm).tolist()), ball.radius_mm)
            for ball, shift_mm in zip(obstacles, shifts_mm, strict=True)
        )

    def aim_at(self, target_mm: tuple[float, float, float]) -> None:
        """Store where the target (x, y, z) is before the needle is inserted into the present phantom."""
        self._target_mm = target_mm

    def locate_target_mm(self) -> tuple[float, float, float] | None:
        """Return where the target (x, y, z) is now: it moves with the needle's tip, and does not move back."""
        track = self._hole.track
        if self._target_mm is None or self._specimen is None or track is None:
            return self._target_mm
        way_mm = math.dist(self._target_mm, _xyz(track.node_at(0.0)))
        moved_mm = self.description.target_moves_mm * min(1.0, track.length_mm / way_mm)
        angle_rad = stream(self._seed, "target", self._specimen.name).uniform(0.0, math.tau)
        x, y, z = self._target_mm
        return x, y + moved_mm * math.sin(angle_rad), z + moved_mm * math.cos(angle_rad)

    def point_at_pixel_mm(self, pixel: tuple[float, float]) -> tuple[float, float, float]:
        """Return the point (x, y, z) of the steering plane that the camera sees at a pixel (u, v)."""
        lens = self.description.lens
        y, z = steering_plane_pose(lens).intersect(unproject(np.array([pixel]), lens))
        return 0.0, float(y[0]), float(z[0])

    def obstacle_mark_px(self, asked: int) -> tuple[float, float]:
        """Return the pixel (u, v) at which the simulated operator sees the next marked obstacle.

        Raises
        ------
        InputError
            If the description marks fewer obstacles.
        """
        marks = self.description.obstacle_marks_mm
        if asked >= len(marks):
            raise InputError(
                f"the simulated operator sees {len(marks)} marked obstacles, and was asked for one more",
                "give each obstacle with ask: true its place in world.obstacle_marks_mm",
            )
        return self._see_mark_px(marks[asked][:2])

    def target_mark_px(self) -> tuple[float, float]:
        """Return the pixel (u, v) at which the simulated operator sees the target."""
        return self._see_mark_px(self.description.target_mark_mm)

    def _see_mark_px(self, mark_mm: tuple[float, float]) -> tuple[float, float]:
        u, v = plane_to_pixels(np.array([mark_mm]), self.description.lens)[0].tolist()
        return u, v

    def _put_before_sheath(self, specimen: GelBlock) -> None:
        self._covering = self._target_mm = None
        self._drawn.clear()
        self._specimen = specimen
        self._enter_hole(specimen, None, 0.0)

    def shift_to_hole(self, specimen: str, hole: int, position_mm: float) -> None:
        """Shift the gel by hand until `position_mm` of it has passed the sheath, towards +y.

        Older tracks move along, up in the picture; a needle that bends towards -y never meets them.

        Raises
        ------
        InputError
            If another specimen is before the sheath, or the position is outside the gel.
        """
        self._refuse_if_stuck(f"the gel is shifted to hole {hole + 1}")
        if self._specimen is None or self._specimen.name != specimen:
            placed = "nothing" if self._specimen is None else self._specimen.name
            message = f"specimen {specimen} is not on the bench; {placed} is"
            raise InputError(message, "place the specimen first")
        if not 0 <= position_mm <= LAST_POSITION_MM:
            limits = f"0 to {LAST_POSITION_MM:g} mm"
            raise InputError(f"hole position {position_mm:g} mm lies outside of the gel, {limits}")
        self._covering = None
        self._enter_hole(self._specimen, hole, position_mm)

    def hold_board(self, view: int, columns: int, rows: int, square_mm: float) -> None:
        """Hold a chessboard with columns x rows inner corners before the camera, in another pose for each view."""
        board, lens = Chessboard(columns, rows, square_mm), self.description.lens
        pose = choose_board_pose(view, board, stream(self._seed, "board", view), lens)
        self._covering = f"board {view}", lambda: draw_board(board, pose, lens, self._white)

    def lay_graph_paper(self, pitch_mm: float) -> None:
        """Lay graph paper into the steering plane, nearly along the sheath, so that it fills the view."""
        random = stream(self._seed, "graph paper")
        lens = self.description.lens
        self._covering = "graph paper", lambda: draw_graph_paper(pitch_mm, random, lens, self._white)

    def clear_bench(self) -> None:
        """Take away specimen, board and paper."""
        self._refuse_if_stuck("the bench is cleared")
        self._specimen, self._hole, self._covering = None, make_empty_hole(), None

    def advance(self, insertion_mm: float, rotation_rad: float, linear_mm: float) -> None:
        """Bring the axes to these positions; the needle cuts further if it goes deeper than before.

        It withdraws and enters again along its path. The linear axis carries a protruding needle along its path.
        Between two calls the bevel has the later call's `rotation_rad`.
        """
        self._insertion_mm, self._linear_mm = insertion_mm, linear_mm
        self._base_rad = rotation_rad + self._clamped_rad
        self._bevel_rad = follow_with_play(self._bevel_rad, self._base_rad, self._torsion_lag_rad())
        hole = self._hole
        if self._specimen is None:
            hole.track = None
        else:
            hole.sheath_reach_mm = max(hole.sheath_reach_mm, linear_mm)
        if self._needle_id is not None and insertion_mm > 0:
            self._cut(hole)

    def _cut(self, hole: Hole) -> None:
        if hole.track is None:
            x, y, z = self.sheath_point_mm()
            start = PathNode(0.0, y, z, hole.heading_rad, 0.0, x, hole.lean_rad)
            needle = self.description.needle
            hole.track = Track(start, hole.radius_mm, needle, hole.unevenness, hole.layers)
            hole.track_linear_mm = self._linear_mm
        hole.track.extend(self._needle_span().to_mm, self._bevel_rad)

    def _torsion_lag_rad(self) -> float:
        """Return how far the bevel may be behind the rotation axis, in each direction."""
        is_in_gel, needle = (
            self._specimen is not None and self._needle_id is not None,
            self.description.needle,
        )
        in_gel_mm = max(0.0, self._insertion_mm) if is_in_gel else 0.0
        return math.radians(needle.torsion_lag_deg + needle.torsion_lag_deg_per_mm * in_gel_mm)

    def picture(self, exposure: float = 1.0) -> npt.NDArray[np.uint8]:
        """Return the camera's picture, (H, W) uint8; each call is another exposure with noise of its own.

        Parameters
        ----------
        exposure : float
            Light gathered, relative to that at which clear gel is `light.level` bright. The sensor saturates at 255.
        """
        scene = self._scene_name()
        count = self._pictures.get(scene, 0)
        self._pictures[scene] = count + 1
        light = self._draw_light(scene)
        if exposure != 1.0:
            light = light * np.float32(exposure)
        return expose(light, self._noise, self.description, stream(self._seed, "picture", scene, count))

    def truth(self) -> dict[str, object]:
        """Return the truth about the insertion in the present hole, ready for JSON.

        Its keys: specimen, gelatin_percent, needle_id, hole, radius_mm (drawn), each possibly None;
        hole_position_mm; sheath_tip_mm [y, z] where the needle left it; tip_mm [y, z], tip_x_mm and arc_length_mm at
        the deepest so far, so that they are the same before and after the needle is withdrawn. In a phantom also the
        keys of `_phantom_truth`.
        """
        hole, track = self._hole, self._hole.track
        start = self.sheath_point_mm() if track is None else _xyz(track.node_at(0.0))
        tip = start if track is None else _xyz(track.node_at(track.length_mm))
        return {
            "specimen": None if self._specimen is None else self._specimen.name,
            "gelatin_percent": None if self._specimen is None else self._specimen.gelatin_percent,
            "needle_id": self._needle_id,
            "hole": hole.number,
            "hole_position_mm": hole.position_mm,
            "radius_mm": hole.radius_mm if math.isfinite(hole.radius_mm) else None,
            "sheath_tip_mm": list(start[1:]),
            "tip_mm": list(tip[1:]),
            "tip_x_mm": tip[0],
            "arc_length_mm": 0.0 if track is None else track.length_mm,
            **self._phantom_truth(),
        }

    def _phantom_truth(self) -> dict[str, object]:
        """Return the truth about an insertion into a phantom, in space; empty for another gel.

        target_mm [x, y, z] where it is now, true_target_error_mm and true_min_clearance_mm, from the needle's surface
        to an obstacle's, each possibly None; true_obstacles where they are, with the clearance
        of each; path_mm [[x, y, z], ...], a point every half millimetre.
        """
        if self._specimen is None or not self._specimen.is_phantom:
            return {}
        track, balls, target = self._hole.track, self._specimen.obstacles, self.locate_target_mm()
        path = np.array([self.sheath_point_mm()]) if track is None else track.points_mm()[:, 1:]
        radius_mm = 0.5 * self.description.needle.diameter_mm
        gaps = [
            float(np.linalg.norm(path - ball.position_mm, axis=1).min()) - ball.radius_mm - radius_mm
            for ball in balls
        ]
        coarse = np.vstack((path[: -1 : round(_PATH_EVERY_MM / NODE_MM)], path[-1:]))
        return {
            "target_mm": None if target is None else list(target),
            "true_target_error_mm": None if target is None else float(np.linalg.norm(path[-1] - target)),
            "true_min_clearance_mm": min(gaps, default=None),
            "true_obstacles": [vars(one) | {"clearance_mm": mm} for one, mm in zip(balls, gaps, strict=True)],
            "path_mm": coarse.round(4).tolist(),
        }

    def tip_mm(self) -> tuple[float, float, float]:
        """Return where the needle's tip (x, y, z) is now, or the sheath's while the needle is inside it."""
        node = self.glance().node_before_tip()
        return self.sheath_point_mm() if node is None else _xyz(node)

    def glance(self) -> Glance:
        """Return what there is to see of sheath and needle now."""
        track, span = self._hole.track, self._needle_span()
        is_out = track is not None and span.to_mm > span.from_mm
        sheath_mm = (self.sheath_point_mm(), self.sheath_point_mm(SHEATH_MM))
        return Glance(track if is_out else None, span.to_mm, sheath_mm, self._hole.radius_mm)

    def locate_markers(self) -> Mapping[int, tuple[PrintedMarkerDescription, tuple[float, float]]]:
        """Return each marker that can be seen now, by its id, and how far it has moved along (y, z) [mm]."""
        if self._specimen is None or not self._specimen.is_phantom:
            return {}
        cut_mm = 0.0 if self._hole.track is None else self._hole.track.length_mm
        moved_mm = self._find_displacement_mm()
        return {
            marker.marker_id: (marker, moved_mm)
            for marker in self.description.markers
            if marker.covered_mm is None or not marker.covered_mm[0] <= cut_mm < marker.covered_mm[1]
        }

    def sheath_point_mm(self, before_end_mm: float = 0.0) -> tuple[float, float, float]:
        """Return the point (x, y, z) of the sheath's axis this far before its end."""
        origin_mm = self.description.sheath_tip_at_origin_linear_mm
        return self._hole.sheath_point_mm(self._linear_mm - origin_mm - before_end_mm)

    def _enter_hole(self, specimen: GelBlock, number: int | None, position_mm: float) -> None:
        place = (number, position_mm)
        if place not in specimen.holes:
            specimen.holes[place] = make_hole(self.description, self._seed, specimen, place, self._needle_id)
        self._hole = specimen.holes[place]

    def _refuse_if_stuck(self, action: str) -> None:
        needle_mm = 0.0 if self._needle_id is None else max(0.0, self._insertion_mm)
        depth_mm = self._linear_mm + needle_mm
        if self._specimen is not None and depth_mm > _STUCK_MM:
            message = f"{action} while the instrument stands {depth_mm:.1f} mm deep in {self._specimen.name}"
            raise InputError(message, f"withdraw needle and sheath to {_STUCK_MM} mm or less first")

    def _needle_span(self) -> PathSpan:
        """Return the part of the track between the sheath's tip and the needle's."""
        sheath_mm = self._linear_mm - self._hole.track_linear_mm
        arrives_mm = self._insertion_mm * (1.0 - self._hole.slip_fraction)
        return PathSpan(sheath_mm, sheath_mm + arrives_mm, self._bevel_rad)

    def _scene_name(self) -> str:
        if self._covering is not None:
            return self._covering[0]
        if self._specimen is None:
            return "empty bench"
        return repr((self._specimen.name, self._hole.number, self._hole.position_mm, self._needle_id))

    def _draw_light(self, scene: str) -> Field32:
        """Return the blurred picture before noise."""
        world, hole, linear_mm = self.description, self._hole, self._linear_mm
        if self._covering is not None:
            _, draw = self._covering
            return self._draw_once("covering", self._covering, lambda: blur(draw(), world.blur_px))
        gel, specimen = self._white, self._specimen
        if specimen is not None:
            gel = self._draw_once("gel", scene, lambda: draw_gel(world, specimen, hole, self._white))
        stands = (scene, linear_mm, hole.sheath_reach_mm)
        behind = self._draw_once("backdrop", stands, lambda: draw_backdrop(world, gel, hole, linear_mm))
        light = draw_with_needle(world, behind, hole, self._needle_span())
        seen = self.locate_markers()
        for marker in world.markers:  # they lie over the needle; two may have one id
            if marker.marker_id in seen:
                draw_marker(light, world, marker, self._find_displacement_mm(), self._white)
        return light

    def _draw_once(self, layer: str, shown: object, draw: Callable[[], _Drawn]) -> _Drawn:
        """Return a layer of the picture, drawn again only after something that it shows has moved."""
        if layer not in self._drawn or self._drawn[layer][0] != shown:
            self._drawn[layer] = (shown, draw())
        drawn: _Drawn = self._drawn[layer][1]
        return drawn

    def _find_displacement_mm(self) -> tuple[float, float]:
        """Return how far the target has moved along (y, z) [mm]."""
        start_mm, target_mm = self._target_mm, self.locate_target_mm()
        if start_mm is None or target_mm is None:
            return 0.0, 0.0
        return target_mm[1] - start_mm[1], target_mm[2] - start_mm[2]


def _xyz(node: PathNode) -> tuple[float, float, float]:
    return node.x_mm, node.y_mm, node.z_mm
