"""Hand-held photographs of ruled paper: error of held-out crossings, and which sheet is not flat."""

from pathlib import Path

from labrig.vision.picture import read_picture
from labrig.vision.plane_calibration import calibrate_plane
from tests.benchmarks.table import print_rows

PHOTOGRAPHS = Path(__file__).parents[3] / "shared" / "data" / "ruled_paper"
FLAT = {"ecg00026.jpg": True, "ecg00031.jpg": False, "ecg00040.jpg": True}
PITCH_MM = 1.0


def print_table() -> None:
    """Print per sheet the crossings, the error of held-out crossings without and with its bend, and the verdict."""
    if not PHOTOGRAPHS.is_dir():
        print(f"skipped: {PHOTOGRAPHS} is not here")
        return
    rows = []
    for name, flat in FLAT.items():
        plane = calibrate_plane(read_picture(PHOTOGRAPHS / name), None, PITCH_MM, (600.0, 250.0), "right")
        verdict = "not flat" if any("not flat" in reason for reason in plane.reasons) else "flat"
        rows.append(
            [
                name,
                plane.crossings,
                f"{plane.crossing_noise_mm:.3f}",
                f"{plane.holdout_rms_mm:.3f}",
                "-" if plane.bend is None else f"{plane.bend.holdout_rms_mm:.3f}",
                "0.150" if flat else "-",
                f"{plane.flatness_mm:.2f}",
                verdict,
                "flat" if flat else "not flat",
            ]
        )
    heads = (
        "sheet",
        "crossings",
        "noise of a crossing, mm rms",
        "left out: plane",
        "with bend",
        "limit",
        "unevenness mm",
        "verdict",
        "wanted",
    )
    print_rows(heads, rows)
    print(
        "plane: a homography and one radial term alone; with bend: and the sheet's height over the plane, a polynomial "
        "whose order the left-out crossings choose; noise: by the differences of neighbouring crossings."
    )
