"""A simulated rig in the place of a bench: its world is what the protocol of an insertion assumes.

The world sees through a pinhole that is fitted to the bench's own map of its plane.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from labrig.devices.can_description import ONLY_SIMULATED
from labrig.devices.needle_state import RollZero
from labrig.devices.rig_file import RigDescription
from labrig.errors import InputError
from labrig.experiments.insertion.protocol import InsertionProtocol
from labrig.experiments.shared.rig_view import load_plane_map
from labrig.needle.kinematics import FloatArray
from labrig.protocol.yaml_file import validate_values
from labrig.simulation.description import GELS_DESIGN_RADIUS_MM, LensDescription
from labrig.simulation.lens import plane_to_pixels
from labrig.vision.plane import PICTURE_AXES, PlaneMap

_LEAST_MM = 0.05
"""Shortest length over which hinges close, or their play is taken up, in the simulated world."""
_WITHOUT_PERSPECTIVE_MM = 1000.0
"""Height of a camera whose map does not tell it: farther than any that stands over a bench."""
_WORST_MM = 0.5
GEL_SDS = 6.5
"""A gel's mean radius is at least so many of its standard deviations, so that none that is drawn is zero or less."""
_GRID = (9, 7)
_MOST_TILT_DEG = 30.0


@dataclass(frozen=True)
class AssumedRig:
    """A simulated rig in the place of a bench, and what its world is made of, as a sentence."""

    rig: RigDescription
    note: str


@dataclass(frozen=True)
class FittedLens:
    """A pinhole over the plane, and the largest distance between what it and the map of the bench show [mm]."""

    lens: LensDescription
    worst_mm: float


def make_assumed_rig(protocol: InsertionProtocol, bench: RigDescription, roll_zero: RollZero) -> AssumedRig:
    """Return a simulated rig with the axes and calibration of a bench, in the world that a protocol assumes.

    Raises
    ------
    InputError
        When the bench has no map of its plane, or no pinhole sees the plane as that does.
    """
    fitted = fit_lens(load_plane_map(bench), (bench.camera.width_px, bench.camera.height_px))
    if fitted.worst_mm > _WORST_MM:
        raise InputError(
            f"no simulated camera sees the plane as the run's own map does: they differ by {fitted.worst_mm:.2f} mm, "
            f"and {_WORST_MM:g} mm is the limit",
            "certify a run whose camera was calibrated with its intrinsics",
        )
    values = bench.model_dump(mode="json") | {
        "kind": ONLY_SIMULATED,
        "state_file": None,
        "can": {"interface": ONLY_SIMULATED},
        "camera": _make_camera(bench),
        "world": _make_world(protocol, roll_zero, fitted.lens),
    }
    rig = validate_values(values, f"the world that {protocol.specimen.name} stands in", RigDescription)
    note = (
        "The run was made on a bench. Its world here is made of what the protocol assumes: radius, play and closing of "
        "the hinges, wandering, slip, and the start out of the plane; without cavities, and with obstacles and target "
        f"where they are stated. The camera is a pinhole that shows the plane as the run's own map does, within "
        f"{fitted.worst_mm:.2f} mm."
    )
    return AssumedRig(rig.placed_in(bench.folder), note)


def _make_camera(bench: RigDescription) -> dict[str, Any]:
    camera = bench.camera
    size = {"width_px": camera.width_px, "height_px": camera.height_px, "rate_hz": camera.rate_hz}
    unset = dict.fromkeys(("gain", "white_balance_k", "focus", "mains_hz", "exposure_us"))
    return {"driver": ONLY_SIMULATED, "pixel_format": "GREY", **size, **unset}


def find_wandering_deg(protocol: InsertionProtocol) -> float:
    """Return how much the needle is assumed to wander out of the plane after a millimetre [deg / mm^0.5]."""
    unseen = protocol.out_of_plane
    if unseen is None:
        return 0.0
    stated_deg = unseen.heading_sd_deg_per_root_mm
    return protocol.estimator.process_sd_deg_per_root_mm if stated_deg is None else stated_deg


def _make_world(protocol: InsertionProtocol, roll_zero: RollZero, lens: LensDescription) -> dict[str, Any]:
    """Return the `world:` of a rig file in which the protocol is right."""
    planner, estimator, unseen = protocol.planner, protocol.estimator, protocol.out_of_plane
    sheath = protocol.sheath
    gel = {
        "gelatin_percent": protocol.specimen.gelatin_percent,
        "radius_mean_mm": planner.radius_mm,
        "radius_sd_mm": min(estimator.radius_sd_mm, planner.radius_mm / GEL_SDS),
    }
    return {
        "gels": [gel],
        "needle": _make_needle(protocol, roll_zero),
        "disturbances": {
            "heading_deg_per_root_mm": estimator.process_sd_deg_per_root_mm,
            "out_of_plane_deg_per_root_mm": find_wandering_deg(protocol),
            "curvature_fraction": 0.0,
            "slip_sd_fraction": min(0.1, estimator.slip_sd),
        },
        "sheath": {
            "diameter_mm": sheath.diameter_mm,
            "lateral_play_sd_mm": 0.0,
            "angle_play_sd_deg": 0.0,
            "x_play_sd_mm": 0.0 if unseen is None else unseen.start_sd_mm,
            "lean_play_sd_deg": 0.0 if unseen is None else min(10.0, unseen.start_sd_deg),
        },
        "lens": lens.model_dump(mode="json"),
        "target_pushed_mm_per_mm": protocol.target.motion_mm_per_mm or (0.0, 0.0),
        "sheath_tip_at_origin_linear_mm": sheath.depth_mm
        if sheath.origin is None
        else sheath.origin.depth_mm,
    }


def _make_needle(protocol: InsertionProtocol, roll_zero: RollZero) -> dict[str, Any]:
    policy, torsion = protocol.policy, roll_zero.torsion
    needle = {
        "diameter_mm": protocol.needle.diameter_mm,
        "hinge_closing_mm": max(_LEAST_MM, policy.closing_mm),
        "backlash_mm": max(_LEAST_MM, policy.backlash_mm),
        "clamp_roll_deg": math.remainder(-math.degrees(roll_zero.zero_rad), 360.0),
        "torsion_lag_deg": 0.0 if torsion is None else math.degrees(torsion.lag_rad),
        "torsion_lag_deg_per_mm": 0.0 if torsion is None else math.degrees(torsion.lag_rad_per_mm),
        # The planner's radius is the needle's own in this gel, whatever it was designed for.
        "design": {"radius_low_mm": GELS_DESIGN_RADIUS_MM, "radius_high_mm": GELS_DESIGN_RADIUS_MM},
    }
    recovery = protocol.recovery
    return needle if recovery is None else {**needle, "leaves_track_mm": recovery.leaves_track_mm}


def fit_lens(plane: PlaneMap, size_px: tuple[int, int]) -> FittedLens:
    """Return the simulated lens that sees the steering plane as a calibrated map does.

    Parameters
    ----------
    plane : PlaneMap
    size_px : (int, int)
        Width and height of the picture.

    Raises
    ------
    MeasurementRefusedError
        When the lens of the map cannot be inverted over the picture.
    """
    u, v = (np.linspace(0.05, 0.95, count) * (side - 1) for count, side in zip(_GRID, size_px, strict=True))
    pixels = np.array([(column, row) for row in v for column in u])
    places_mm = plane.to_mm(pixels)
    fixed, height_mm = _describe_optics(plane, size_px)
    first = np.array([height_mm, 0.0, 0.0, _find_roll_deg(plane), *plane.origin_px])

    def lens_of(values: FloatArray) -> LensDescription:
        height, across, along, roll, *origin = values.tolist()
        return LensDescription(
            **fixed,
            distance_mm=min(max(height, 1.0), 1000.0),
            tilt_deg=min(math.hypot(across, along), _MOST_TILT_DEG),
            tilt_azimuth_deg=math.degrees(math.atan2(along, across)),
            roll_deg=roll,
            origin_px=(origin[0], origin[1]),
        )

    def miss_px(values: FloatArray) -> FloatArray:
        return np.asarray((plane_to_pixels(places_mm, lens_of(values)) - pixels).ravel())

    lens = lens_of(least_squares(miss_px, first, x_scale=np.array([10.0, 1.0, 1.0, 1.0, 10.0, 10.0])).x)
    off_mm = plane.to_mm(plane_to_pixels(places_mm, lens)) - places_mm
    return FittedLens(lens, float(np.linalg.norm(off_mm, axis=1).max()))


def _describe_optics(plane: PlaneMap, size_px: tuple[int, int]) -> tuple[dict[str, Any], float]:
    """Return what is known of the lens by its calibration, and the camera's height over the plane [mm]."""
    size = {"width_px": size_px[0], "height_px": size_px[1]}
    known = plane.intrinsics
    if known is None or plane.telecentric:
        middle = {"cx_px": 0.5 * (size_px[0] - 1), "cy_px": 0.5 * (size_px[1] - 1)}
        focal_px = _WITHOUT_PERSPECTIVE_MM / plane.mm_per_px
        return {
            **size,
            **middle,
            "fx_px": focal_px,
            "fy_px": focal_px,
            "distortion": (0.0,) * 5,
        }, _WITHOUT_PERSPECTIVE_MM
    optics = {"fx_px": known.fx, "fy_px": known.fy, "cx_px": known.cx, "cy_px": known.cy}
    return {**size, **optics, "distortion": known.distortion}, known.fx * plane.mm_per_px


def _find_roll_deg(plane: PlaneMap) -> float:
    """Return how the camera is turned about its axis, to within 45 degrees, by where +z points in the picture."""
    _, (right, down) = PICTURE_AXES[plane.insertion]
    return math.degrees(math.atan2(down, right))
