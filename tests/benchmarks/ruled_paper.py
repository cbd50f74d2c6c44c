"""Hand-held photographs of ruled paper: error of held-out points, and which sheet is not flat."""

from pathlib import Path

from labrig.vision.calibrate_plane import calibrate_plane
from labrig.vision.picture import read_picture
from tests.benchmarks.table import print_rows

PHOTOGRAPHS = Path(__file__).parents[3] / "shared" / "data" / "ruled_paper"
FLAT = {"ecg00026.jpg": True, "ecg00031.jpg": False, "ecg00040.jpg": True}
PITCH_MM = 1.0
# Five millimetres are about 22 pixels in all three.
PX_PER_MM = 4.4


def print_table() -> None:
    """Print per sheet the points, the error of held-out points, and the verdict."""
    if not PHOTOGRAPHS.is_dir():
        print(f"skipped: {PHOTOGRAPHS} is not here")
        return
    rows = []
    for name, flat in FLAT.items():
        plane = calibrate_plane(
            read_picture(PHOTOGRAPHS / name), None, PITCH_MM, (600.0, 250.0), "right", px_per_mm=PX_PER_MM
        )
        verdict = "not flat" if any("not flat" in reason for reason in plane.reasons) else "flat"
        wanted = "flat" if flat else "not flat"
        rows.append(
            [name, plane.points, f"{plane.holdout_rms_mm:.3f}", f"{plane.flatness_mm:.2f}", verdict, wanted]
        )
    heads = ("sheet", "points", "left out: plane", "unevenness mm", "verdict", "wanted")
    print_rows(heads, rows)
