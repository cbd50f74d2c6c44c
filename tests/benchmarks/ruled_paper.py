"""Hand-held photographs of ruled paper: crossings that the fit did not see, and which sheet is not flat."""

from pathlib import Path

from labrig.vision import calibrate_plane, read_picture
from tests.benchmarks.table import print_rows

PHOTOGRAPHS = Path(__file__).parents[3] / "shared" / "data" / "ruled_paper"
FLAT = {"ecg00026.jpg": True, "ecg00031.jpg": False, "ecg00040.jpg": True}
PITCH_MM = 1.0


def print_table() -> None:
    """Each sheet: crossings found, error of those left out, unevenness, and whether it is said to be flat."""
    if not PHOTOGRAPHS.is_dir():
        print(f"skipped: {PHOTOGRAPHS} is not here")
        return
    rows = []
    for name, flat in FLAT.items():
        plane = calibrate_plane(read_picture(PHOTOGRAPHS / name), None, PITCH_MM, (600.0, 250.0), "right")
        said = "not flat" if any("not flat" in reason for reason in plane.reasons) else "flat"
        rows.append(
            [
                name,
                plane.crossings,
                f"{plane.holdout_rms_mm:.3f}",
                "0.150" if flat else "-",
                f"{plane.flatness_mm:.2f}",
                said,
                "flat" if flat else "not flat",
            ]
        )
    heads = ("sheet", "crossings", "left out, mm rms", "limit", "unevenness mm", "said", "wanted")
    print_rows(heads, rows)
