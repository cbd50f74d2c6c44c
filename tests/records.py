"""Make the kept records anew, by labrig's own commands: `python -m tests.records [NAME...]`.

It runs from the top of a checkout.
A record of each experiment is kept under tests/records. They are made anew when the format of records changes, or what
a procedure asks. Their manifests say by which commit and on which processor; another processor measures and replays
them within the tolerances of `labrig.record.agreement`.
"""

import argparse
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from tests.small_camera import SMALL_CAMERA, set_options

KEPT = Path("tests/records")
FOUND = KEPT / "camera-calibration" / "analysis" / "001"
SMALL = [
    *("--rig", "calibration/rig-simulated.yaml"),
    *set_options(
        *SMALL_CAMERA, "camera.distance_mm=63", "world.noise_sd=0", "recording.state_rate_hz=2",
        "can.heartbeat.period_ms=250", "can.heartbeat.timeout_ms=1250",
    ),
]  # fmt: skip
QUICK = [*SMALL, *shlex.split(f"""
  --set rig.calibration.intrinsics=../{FOUND}/intrinsics.json --set rig.calibration.plane=../{FOUND}/plane.json
  --set sheath.speed_mm_s=15 --set insertion.speed_mm_s=5 --set insertion.withdraw_speed_mm_s=15
""")]  # fmt: skip
ROLLS = ("--set", "roll_zero.rolls=5", "--set", "roll_zero.length_mm=12")


def main() -> None:
    """Make the records that are named, or all of them."""
    parser = argparse.ArgumentParser(description="Make the kept records anew, with labrig's own commands.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(RECORDS)}; all without one")
    names = parser.parse_args().names or list(RECORDS)
    if unknown := sorted(set(names) - set(RECORDS)):
        parser.error(f"{', '.join(unknown)}: not of {', '.join(RECORDS)}")
    for name, make in RECORDS.items():
        if name in names:
            make()


def make_calibration() -> None:
    """Calibrate the small simulated camera; every other record uses what it finds."""
    run("camera-calibration", "calibration", *SMALL, *shlex.split("""
        --set rig.calibration.plane=null --set rig.calibration.intrinsics=null
        --set views=6 --set plane.origin_px=[123,112]"""))  # fmt: skip


def make_steerability() -> None:
    """Insert twice into one gel."""
    run("steerability", "steerability", *QUICK, *shlex.split("""
        --set insertions_per_specimen=2 --set insertion.length_mm=22 --set insertion.frame_every_mm=20
        --set "specimens=[{name: gel, gelatin_percent: 13}]" """))  # fmt: skip


def make_roll_zero() -> None:
    """Find the roll of the bevel."""
    run("roll-zero", "roll-zero", *QUICK, *ROLLS, "--set", "roll_zero.torsion=null")


def make_insertion() -> None:
    """Steer past an obstacle to a target."""
    run("insertion", "insertion", *QUICK, *ROLLS, *shlex.split("""
        --set target.position_mm=[0,2,20] --set "obstacles=[{position_mm: [0, 9, 12], radius_mm: 3}]"
        --set insertion.max_length_mm=30 --set insertion.frame_every_mm=3
        --set policy.near_mm=0 --set policy.final_mm=0"""))  # fmt: skip


def make_design() -> None:
    """Design the hinge of a needle."""
    run("design", "design", "--set", "grid_points=3")


def make_import() -> None:
    """Import the last picture of each kept insertion of the sweep, and measure them."""
    shutil.rmtree(KEPT / "import", ignore_errors=True)
    pictures = Path("import")
    pictures.mkdir()
    try:
        for frame in (3, 7):
            shutil.copy(KEPT / "steerability" / "frames" / f"{frame:06}.png", pictures)
        labrig("import", str(pictures), *shlex.split(f"""
            --intrinsics {FOUND}/intrinsics.json --plane {FOUND}/plane.json
            --needle-diameter-mm 1.2 --sheath-diameter-mm 2 --runs-dir {KEPT} --json"""))  # fmt: skip
    finally:
        shutil.rmtree(pictures)
    (record,) = KEPT.glob("*-import")
    record.rename(KEPT / "import")
    labrig("reanalyze", str(KEPT / "import"))
    (KEPT / "import" / "report.html").unlink(missing_ok=True)


def run(name: str, protocol: str, *options: str) -> None:
    """Run an example protocol as the record `name`, in place of the one that is there."""
    shutil.rmtree(KEPT / name, ignore_errors=True)
    labrig(
        "run", f"protocols/{protocol}.yaml", "--run-name", name, "--runs-dir", str(KEPT), *options, "--yes"
    )
    (KEPT / name / "report.html").unlink(missing_ok=True)


def labrig(*arguments: str) -> None:
    """Run a command of labrig; end if it fails."""
    subprocess.run([str(Path(sys.executable).with_name("labrig")), *arguments], check=True)


RECORDS: dict[str, Callable[[], None]] = {
    "camera-calibration": make_calibration, "steerability": make_steerability, "roll-zero": make_roll_zero,
    "insertion": make_insertion, "design": make_design, "import": make_import,
}  # fmt: skip

if __name__ == "__main__":
    main()
