"""The intrinsics of OpenCV's own chessboard photographs beside the known answer."""

import json
import subprocess
import sys
from pathlib import Path

from tests.benchmarks.table import print_rows

PHOTOGRAPHS = Path(__file__).parents[3] / "shared" / "data" / "opencv_chess"
KNOWN = {"fx": (532.83, 0.44), "fy": (532.95, 0.46), "cx": (342.49, 0.46), "cy": (233.86, 0.51)}


def print_table() -> None:
    """Each parameter, its sigma, the known value and how many sigma lie between."""
    pictures = sorted(str(path) for path in PHOTOGRAPHS.glob("left*.jpg"))
    if not pictures:
        print(f"skipped: {PHOTOGRAPHS} is not here")
        return
    command = [
        sys.executable,
        "-m",
        "labrig",
        "calibrate",
        "intrinsics",
        *pictures,
        "--board",
        "9x6",
        "--square-mm",
        "25",
    ]
    found = json.loads(
        subprocess.run([*command, "--json"], check=True, capture_output=True, text=True).stdout
    )
    rows = [
        [
            name,
            f"{found[name]:.2f}",
            f"{found['sigma'][name]:.2f}",
            f"{known:.2f} ± {sigma}",
            f"{(found[name] - known) / sigma:+.2f}",
        ]
        for name, (known, sigma) in KNOWN.items()
    ]
    print_rows(("parameter", "found px", "sigma", "known", "off, in known sigma"), rows)
    held_out = f"held out {found['holdout_rms_px']:.3f} px"
    print(f"RMS {found['rms_px']:.3f} px (limit 0.22), {held_out}, accepted {found['accepted']}")
