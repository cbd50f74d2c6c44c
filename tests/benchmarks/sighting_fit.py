"""Fits the errors of sightings to runs of the simulated rig: its record against the truth as its own map reads it.

The needle of a record is cut again in the world of its seed, so that the tip of each picture is known exactly.
"""

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from labrig.experiments.insertion.plan import make_roll_zero_order
from labrig.experiments.insertion.virtual_camera import (
    TURN_MM,
    CalibratedCamera,
    SightingErrors,
    locate_points,
)
from labrig.experiments.insertion.virtual_roll_zero import find_stray_mm
from labrig.experiments.insertion.virtual_shaft import square_distances
from labrig.experiments.shared.rig_view import load_plane_map
from labrig.needle.kinematics import FloatArray
from labrig.simulation.world import World
from labrig.vision.perspective import Perspective
from tests.benchmarks.virtual_runs import read_policy, read_simulated_rig

_BEYOND_MM = 2.0
"""Nearer to the sheath the tip is not compared."""


_EXACT = SightingErrors(**{field.name: 0.0 for field in fields(SightingErrors)})


@dataclass(frozen=True)
class _Sighting:
    """A sighting of the tip off the truth, along the needle and to its left, and what its error may depend on."""

    along_mm: float
    across_mm: float
    side: float
    turn_rad: float
    rim: float


def fit_sighting_errors(runs: Sequence[Path]) -> dict[str, float]:
    """Return the means, slopes and standard deviations of `SightingErrors` by their names, as in these records."""
    records = [_read(run) for run in runs]
    seen = [sighting for record in records for sighting in _compare_tips(record)]
    columns = np.array([(s.along_mm, s.across_mm, s.side, s.turn_rad, s.rim) for s in seen])
    along, across, side, turn, rim = columns.T
    (along_mm, rim_mm), along_sd_mm = _fit(along, (np.ones_like(rim), rim))
    (across_mm, side_mm, turn_mm), across_sd_mm = _fit(across, (np.ones_like(side), side, -turn))
    sheaths = np.array([_compare_sheath(record) for record in records])
    bends = np.concatenate([_compare_bends(record) for record in records])
    return {
        "along_mm": along_mm,
        "along_sd_mm": along_sd_mm,
        "across_mm": across_mm,
        "across_sd_mm": across_sd_mm,
        "rim_mm": rim_mm,
        "side_mm": side_mm,
        "turn_mm": turn_mm,
        "sheath_along_mm": float(sheaths[:, 1].mean()),
        "sheath_sd_mm": math.sqrt(float(sheaths[:, :2].var(axis=0).mean())),
        "sheath_sd_rad": float(sheaths[:, 2].std()),
        "bend_mm": float(bends.mean()),
        "bend_sd_mm": float(bends.std()),
    }


def _fit(values: FloatArray, by: Sequence[FloatArray]) -> tuple[list[float], float]:
    """Return the slopes of values by columns, and the standard deviation about them."""
    columns = np.column_stack(by)
    slopes = np.linalg.lstsq(columns, values, rcond=None)[0]
    return slopes.tolist(), float((values - columns @ slopes).std())


@dataclass(frozen=True)
class _Record:
    """The events of a run, and its seed."""

    seed: int
    events: tuple[dict[str, Any], ...]

    def find(self, kind: str) -> dict[str, Any]:
        """Return its first event of a kind."""
        return next(event for event in self.events if event["kind"] == kind)


def _read(run: Path) -> _Record:
    lines = (run / "events.jsonl").read_text(encoding="utf-8").splitlines()
    seed = json.loads((run / "manifest.json").read_text(encoding="utf-8"))["seed"]
    return _Record(seed, tuple(map(json.loads, lines)))


def _make_camera() -> CalibratedCamera:
    rig = read_simulated_rig()
    assert rig.world is not None
    return CalibratedCamera(rig.world.lens, load_plane_map(rig), np.random.default_rng(0), _EXACT)


def _place(record: _Record) -> World:
    """Return the world of a run with its phantom before the sheath, which is in."""
    rig, protocol = read_simulated_rig(), read_policy("default")
    assert rig.world is not None
    world = World(rig.world, record.seed)
    world.mount_needle(protocol.needle.needle_id)
    world.place_phantom(protocol.specimen.name, protocol.specimen.gelatin_percent, [])
    world.advance(0.0, record.find("roll_zero")["zero_rad"], protocol.sheath.depth_mm)
    return world


def _compare_tips(record: _Record) -> Iterator[_Sighting]:
    camera, world = _make_camera(), _place(record)
    zero_rad, linear_mm = record.find("roll_zero")["zero_rad"], read_policy("default").sheath.depth_mm
    perspective, base_rad = Perspective.of(camera.plane), zero_rad
    for event in record.events:
        if event["kind"] == "flip":
            world.advance(event["depth_mm"], base_rad, linear_mm)
            base_rad = event["to_rad"]
            world.advance(event["depth_mm"], base_rad, linear_mm)
        if event["kind"] != "observation":
            continue
        world.advance(event["depth_mm"], base_rad, linear_mm)
        tip, before = world.node_before_tip(), world.node_before_tip(TURN_MM)
        if tip is None or before is None or event["tip_mm"] is None or event["depth_mm"] < _BEYOND_MM:
            continue
        places_mm, _ = locate_points(np.array([world.tip_mm()]), camera.lens, camera.plane)
        y, z = (np.array(event["tip_mm"][1:]) - places_mm[0]).tolist()
        sine, cosine = math.sin(tip.heading_rad), math.cos(tip.heading_rad)
        yield _Sighting(
            y * sine + z * cosine,
            y * cosine - z * sine,
            -math.cos(base_rad - zero_rad),
            tip.heading_rad - before.heading_rad,
            float(square_distances(places_mm, perspective)[0]),
        )


def _compare_sheath(record: _Record) -> tuple[float, float, float]:
    """Return by how much the sheath's end (y, z) and heading are off in a run."""
    camera, world, found = _make_camera(), _place(record), record.find("origin")
    (y, z), heading_rad = camera.locate_sheath(world)
    return found["tip_mm"][0] - y, found["tip_mm"][1] - z, found["heading_rad"] - heading_rad


def _compare_bends(record: _Record) -> FloatArray:
    """Return by how much the deflections of the search for the roll zero are off, towards the bend."""
    protocol, rig, camera = read_policy("default"), read_simulated_rig(), _make_camera()
    assert protocol.roll_zero is not None
    assert rig.world is not None
    order, world = make_roll_zero_order(protocol, protocol.roll_zero), World(rig.world, record.seed)
    world.mount_needle(protocol.needle.needle_id)
    world.place_specimen(order.steps.specimen.name, order.steps.specimen.gelatin_percent)
    exact = np.array([find_stray_mm(order, step, world, camera) for step in range(order.steps.rolls)])
    found = np.array(record.find("roll_zero")["deflection_mm"])
    return np.asarray((found - exact) * np.sign(exact))
