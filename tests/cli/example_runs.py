"""The example protocols, shortened, as arguments of the commands that people use."""

from collections.abc import Mapping

from tests.cli.conftest import RIG, ROOT
from tests.small_camera import CALIBRATED_SMALL_CAMERA, SMALL_CAMERA, set_options

PROTOCOLS = ROOT / "protocols"

# Each example as short as it can be and still succeed.
SHORTENED: Mapping[str, tuple[str, ...]] = {
    "steerability": (
        "specimens=[{name: gel, gelatin_percent: 13}]", "insertions_per_specimen=1", "insertion.length_mm=22",
        "insertion.speed_mm_s=5", "insertion.frame_every_mm=20",
    ),
    "insertion": (
        "target.position_mm=[0,2,20]", "obstacles=[{position_mm: [0,9,12], radius_mm: 3}]",
        "insertion.max_length_mm=30", "insertion.speed_mm_s=2", "insertion.frame_every_mm=2",
        "policy.near_mm=0", "policy.final_mm=0", "roll_zero.rolls=5", "roll_zero.length_mm=12",
    ),
    "roll-zero": ("roll_zero.rolls=5", "roll_zero.length_mm=12", "roll_zero.torsion=null"),
    "calibration": ("views=6",),
    "design": ("grid_points=3",),
}  # fmt: skip
_TO_CALIBRATE = (
    *SMALL_CAMERA, "world.noise_sd=0", "camera.distance_mm=63", "calibration.plane=null",
    "calibration.intrinsics=null",
)  # fmt: skip


def of_protocol(name: str) -> tuple[object, ...]:
    """Return the arguments that name an example protocol, a rig with a small camera, and what shortens it."""
    settings = [word for setting in SHORTENED[name] for word in ("--set", setting)]
    if name == "design":
        return (PROTOCOLS / "design.yaml", *settings)
    camera: tuple[str, ...] = CALIBRATED_SMALL_CAMERA
    if name == "calibration":
        camera = _TO_CALIBRATE
        settings += ["--set", "plane.origin_px=[123,112]"]
    return (PROTOCOLS / f"{name}.yaml", "--rig", RIG, *set_options(*camera), *settings)
