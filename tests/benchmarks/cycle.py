"""A control cycle of an insertion at 1080p: find the tip, estimate its pose, decide on the path."""

import math
import statistics
import time
from pathlib import Path

import cv2
import numpy as np

from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.insertion.aim import make_aim
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.insertion.settings import make_insertion_settings
from labrig.protocol.load import load_protocol
from labrig.simulation.description import LensDescription, WorldDescription
from labrig.simulation.gel import Ball
from labrig.simulation.lens import plane_to_pixels
from labrig.simulation.world import World
from labrig.steering.policy import TipSighting
from labrig.steering.step import start_steering, step_steering
from labrig.steering.tip_search import TipView, find_tip
from labrig.vision.plane import PlaneMap
from labrig.vision.tip_template import cut_template
from tests.benchmarks.table import print_rows

PROTOCOL = Path(__file__).parents[2] / "protocols" / "insertion.yaml"
_LENS = LensDescription(
    width_px=1920,
    height_px=1080,
    fx_px=2700.0,
    fy_px=2703.0,
    cx_px=967.0,
    cy_px=528.0,
    distortion=(0.0, 0.0, 0.0, 0.0, 0.0),
    distance_mm=185.0,
    origin_px=(225.0, 465.0),
)
_WORLD = WorldDescription(lens=_LENS, noise_sd=3.0)
_STEP_MM = 0.25
_TEMPLATE_DEPTH_MM, _TEMPLATE_SIDE_PX = 12.0, 61
SEEDS = 3


def print_table() -> None:
    """Print the time of a cycle and its parts over whole insertions, without reading the frame."""
    timed = [cycle for seed in range(SEEDS) for cycle in _time_cycles(seed)]
    whole = [found + decided for found, decided, _ in timed]
    worked = [processor for *_, processor in timed]
    print_rows(
        (f"ms, over {len(timed)} cycles of {SEEDS} insertions, 1920 x 1080 px", "median", "worst", "limits"),
        [
            ["a cycle", *_row(whole), "10, 33"],
            ["... in processor time, without the load of other programs", *_row(worked), "-"],
            ["finding the tip", *_row([cycle[0] for cycle in timed]), "-"],
            [
                "estimating, and replanning on an occasion",
                *_row([cycle[1] for cycle in timed]),
                "-",
            ],
        ],
    )


def _row(times: list[float]) -> tuple[str, str]:
    return _ms(statistics.median(times)), _ms(max(times))


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.2f}"


def _time_cycles(seed: int) -> list[tuple[float, float, float]]:
    """Return the times of finding and deciding, and the processor time [s], at each look of an insertion."""
    protocol = load_protocol(PROTOCOL, PROTOCOL_MODELS)
    assert isinstance(protocol, InsertionProtocol)
    view = _make_view()
    aim = make_aim(protocol, view.plane)
    settings = make_insertion_settings(protocol, aim.target_mm, aim.obstacles)
    world = _make_world(
        seed, tuple(Ball(obstacle.position_mm, obstacle.radius_mm) for obstacle in aim.obstacles)
    )
    state, command = start_steering(settings)
    bevel_rad = at_mm = 0.0
    timed = []
    while command.stop is None:
        bevel_rad += -abs(command.roll_rad) if bevel_rad > 0.0 else abs(command.roll_rad)
        at_mm = _insert(world, at_mm, command.observe_at_mm, bevel_rad)
        image = world.picture()
        started, worked = time.perf_counter(), time.process_time()
        seen = find_tip(view, image, state.predict(at_mm, settings), state.tip, bevel_rad)
        found = time.perf_counter()
        state, command = step_steering(state, TipSighting(at_mm, seen.position_mm), settings)
        decided, processor = time.perf_counter() - found, time.process_time() - worked
        timed.append((found - started, decided, processor))
    assert command.stop == "target_reached", command.detail
    return timed


def _make_world(seed: int, obstacles: tuple[Ball, ...]) -> World:
    """Return a world with the sheath in its block and the needle in the sheath."""
    world = World(_WORLD, seed)
    world.mount_needle("N1")
    world.place_phantom("phantom", 13.0, obstacles)
    world.advance(0.0, 0.0, _WORLD.sheath_tip_at_origin_linear_mm)
    return world


def _insert(world: World, from_mm: float, to_mm: float, bevel_rad: float) -> float:
    for place_mm in np.linspace(from_mm, to_mm, max(2, math.ceil((to_mm - from_mm) / _STEP_MM) + 1))[1:]:
        world.advance(float(place_mm), bevel_rad, _WORLD.sheath_tip_at_origin_linear_mm)
    return to_mm


def _make_view() -> TipView:
    """Return the exact plane map of the lens, and a template cut from another insertion."""
    corners_mm = np.array([(-40.0, 0.0), (30.0, 0.0), (-40.0, 110.0), (30.0, 110.0)])
    corners_px = plane_to_pixels(corners_mm, _LENS)
    homography = np.asarray(
        cv2.getPerspectiveTransform(corners_px.astype(np.float32), corners_mm.astype(np.float32)), np.float64
    )
    size = (_LENS.width_px, _LENS.height_px)
    plane = PlaneMap(
        homography=homography,
        origin_px=_LENS.origin_px,
        insertion="right",
        image_size=size,
        mm_per_px=_LENS.distance_mm / _LENS.fx_px,
    )
    world = _make_world(100, ())
    _insert(world, 0.0, _TEMPLATE_DEPTH_MM, 0.0)
    line = world.centre_line_mm(2000)
    heading_rad = math.atan2(*(line[-1] - line[-4]))
    u, v = plane.to_px(line[-1:])[0].tolist()
    image = world.picture()
    return TipView(
        plane, cut_template(image, (u, v), heading_rad, side_px=_TEMPLATE_SIDE_PX, insertion="right")
    )
