"""A short run of each example protocol, and of imported pictures, made by the commands that people use."""

import hashlib
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tests.cli.conftest import RIG, ROOT, printed_json
from tests.small_camera import CALIBRATED_SMALL_CAMERA, SMALL_CAMERA, set_options

PROTOCOLS = ROOT / "protocols"
FIRST = ROOT / "tests" / "records" / "steerability"

# Each example as short as it can be and still succeed.
SHORTENED: Mapping[str, tuple[str, ...]] = {
    "steerability": (
        "specimens=[{name: gel, gelatin_percent: 13}]", "insertions_per_specimen=1", "insertion.length_mm=22",
        "insertion.speed_mm_s=5", "insertion.frame_every_mm=20",
    ),
    "insertion": (
        "target.position_mm=[0,2,20]", "obstacles=[{position_mm: [0,9,12], radius_mm: 3}]",
        "insertion.max_length_mm=30", "insertion.speed_mm_s=2", "insertion.frame_every_mm=2",
        "policy.near_mm=0", "policy.final_mm=0", "roll_zero.rolls=4", "roll_zero.length_mm=12",
    ),
    "roll-zero": ("roll_zero.rolls=4", "roll_zero.length_mm=12", "roll_zero.torsion=null"),
    "calibration": ("views=6",),
    "design": ("grid_points=3",),
}  # fmt: skip
EXAMPLES = (*SHORTENED, "import")
_TO_CALIBRATE = (
    *SMALL_CAMERA,
    "world.noise_sd=0",
    "camera.distance_mm=63",
    "calibration.plane=null",
    "calibration.intrinsics=null",
)


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


def make_example(name: str, runs_dir: Path) -> tuple[Path, dict[str, Any]]:
    """Return a run that has come to its end, and what the command that made it printed; a design is a kept one."""
    if name == "design":  # takes long to compute
        run = Path(shutil.copytree(ROOT / "tests" / "records" / name, runs_dir / name))
        (run / "frames").mkdir()  # an empty folder is not in a checkout
        return run, {"checksum": hashlib.sha256((run / "SHA256SUMS").read_bytes()).hexdigest()}
    if name == "import":
        calibration = FIRST / "calibration"
        (document,) = printed_json(
            "import", FIRST / "frames", "--intrinsics", calibration / "intrinsics.json",
            "--plane", calibration / "plane.json", "--needle-diameter-mm", 1.2, "--runs-dir", runs_dir, "--json",
        )  # fmt: skip
    else:
        document = printed_json("run", *of_protocol(name), "--runs-dir", runs_dir, "--json")
    return Path(document["run"]), document
