"""The intrinsics of known photographs and corners beside their published values."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from labrig.vision.calibrate_lens import (
    board_points_mm,
    calibrate_from_pictures,
    calibrate_intrinsics,
    find_board,
)
from labrig.vision.intrinsics import Intrinsics
from labrig.vision.lens_judgement import measure_effect
from labrig.vision.picture import read_picture
from tests.benchmarks.table import print_rows

DATA = Path(__file__).parents[3] / "shared" / "data"
LEFT = {"fx": (532.83, 0.44), "fy": (532.95, 0.46), "cx": (342.49, 0.46), "cy": (233.86, 0.51)}
# Zhang's own model has a skew and two radial coefficients; his views through labrig's model give his focal lengths.
ZHANG = {"fx": 832.5, "fy": 832.53}
RIGHT = Path("/usr/share/doc/opencv-doc/examples/data")


def print_table() -> None:
    """Print OpenCV's left set and Zhang's views beside published values, and sigma beside a jackknife."""
    if not DATA.is_dir():
        print(f"skipped: {DATA} is not here")
        return
    pictures = [(path.name, read_picture(path)) for path in sorted((DATA / "opencv_chess").glob("left*.jpg"))]
    found = calibrate_from_pictures(pictures, 9, 6, 25.0)
    rows = [_row(f"left set {name}, px", getattr(found, name), *known, 2) for name, known in LEFT.items()]
    zhang = _calibrate_zhang()
    rows += [
        _row(f"Zhang's {name}", getattr(zhang, name), known, zhang.sigma[name] or np.nan, 6)
        for name, known in ZHANG.items()
    ]
    for name, folder in (("left", DATA / "opencv_chess"), ("right", RIGHT)):
        rows += _check_sigma(name, folder)
    print_rows(("figure", "measured", "known", "off", "limit"), rows)
    print(f"left set: corners of views left out are predicted to {found.holdout_rms_px:.3f} px")


def _row(what: str, value: float, known: float, sigma: float, digits: int) -> list[object]:
    """Return a parameter beside a known one."""
    return [what, f"{value:.{digits}f}", f"{known:.{digits}f}", f"{(value - known) / sigma:+.2f} sigma", "2"]


def _check_sigma(name: str, folder: Path) -> list[list[object]]:
    """Return rows: whether a set is accepted, and sigma of fx and the effect beside a jackknife."""
    paths = sorted(folder.glob(f"{name}[0-9][0-9].jpg"))
    if not paths:
        return [[f"{name} set", "not here", "", "", ""]]
    board = board_points_mm(9, 6, 25.0)
    views = [find_board(read_picture(path), 9, 6).pixels for path in paths]

    def calibrate(some: Sequence[int]) -> Intrinsics:
        return calibrate_intrinsics([board] * len(some), [views[index] for index in some], (640, 480))

    count = len(views)
    whole = calibrate(range(count))
    others = ([other for other in range(count) if other != index] for index in range(count))
    without = np.array([calibrate(some).parameters() for some in others])
    spread = without - without.mean(axis=0)
    jackknife = (count - 1) / count * spread.T @ spread
    sigma, spread_px = whole.sigma["fx"] or np.nan, float(np.sqrt(jackknife[0, 0]))
    by_jackknife = measure_effect(replace(whole, covariance=tuple(map(tuple, jackknife.tolist()))))
    rows: list[list[object]] = [
        [f"{name} set", "accepted" if whole.accepted else "refused", "accepted", "", "accepted"],
        [f"{name} set, sigma of fx, px; jackknife", f"{sigma:.2f}", f"{spread_px:.2f}", "", "1.5 times"],
    ]
    if whole.effect is not None and by_jackknife is not None:
        for part in ("length", "radius", "distance"):
            shares = (f"{100.0 * getattr(effect, part):.3f}" for effect in (whole.effect, by_jackknife))
            rows.append([f"{name} set, effect on a {part}, %; jackknife", *shares, "", "1.5 times"])
    return rows


def _calibrate_zhang() -> Intrinsics:
    """Return the lens by Zhang's five views."""
    board = np.loadtxt(DATA / "zhang" / "Model.txt").reshape(-1, 2) * 25.4
    views = [np.loadtxt(path).reshape(-1, 2) for path in sorted((DATA / "zhang").glob("data*.txt"))]
    return calibrate_intrinsics([board] * len(views), views, (640, 480))
