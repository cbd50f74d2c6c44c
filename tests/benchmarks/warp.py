"""The calibration of a lens from warped boards and from sets with bad frames, on corners of a simulation of its own."""

import os
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from labrig.vision.calibrate_lens import calibrate_intrinsics
from labrig.vision.intrinsics import Intrinsics
from tests.benchmarks.table import print_rows
from tests.vision.warped_boards import (
    FloatArray,
    Shape,
    SimulatedBoard,
    SimulatedCamera,
    draw_views,
    parabolas,
)

CAMERA = SimulatedCamera()
DRAWS = int(os.environ.get("LABRIG_BENCHMARK_DRAWS", "200"))
BAD_DRAWS = 30
WARPS_MM = (0.0, 0.1, 0.3, 0.5)
SLIGHT = parabolas(0.1, 0.05)
COMPARED = ("fx", "fy", "cx", "cy")


def print_table() -> None:
    """Print the stated over the actual error of the lens for each warp, then what becomes of sets with bad frames."""
    print(
        f"{DRAWS} sets of random poses each, the same for each warp: 9 x 6 corners of 25 mm, noise 0.15 px, fx "
        f"{CAMERA.fx:g} px; the columns are bent by half the warp of the rows. Error and sigma are rms, of fx. A ratio "
        "is rms sigma over rms error, to be 0.8 to 1.25, with the 95 % interval of so many draws by chi-square."
    )
    rows = [
        _measure(
            f"{count} views, tilted to 45 degrees", f"{warp:g}", parabolas(warp, 0.5 * warp), count, 45.0
        )
        for count in (12, 6)
        for warp in WARPS_MM
    ]
    rows.append(_measure("12 views, tilted to 45 degrees", "0.3, saddle", lambda x, y: 0.3 * x * y, 12, 45.0))
    rows += [
        _measure(
            f"{count} views, tilted to {tilt:g} degrees",
            f"{warp:g}",
            parabolas(warp, 0.5 * warp),
            count,
            tilt,
        )
        for count, tilt in ((2, 45.0), (6, 3.0))
        for warp in (0.0, 0.5)
    ]
    ratios = tuple(f"ratio {name}" for name in COMPARED)
    heads = ("views", "warp mm", "error px", "sigma px", *ratios, "rows mm", "sigma mm", "accepted")
    print_rows(heads, rows)
    print(f"\n{BAD_DRAWS} sets of twelve views each, of which some are bad")
    cases: tuple[tuple[str, ...], ...] = (
        (),
        ("bent by 3 mm",),
        ("bent by -3 mm",),
        ("twisted by 3 mm",),
        ("rolling shutter, 1.5 px",),
        ("focal length +3 %",),
        ("noise of 1 px",),
        ("bent by 3 mm", "bent by -3 mm"),
        ("bent by 3 mm", "twisted by 3 mm", "rolling shutter, 1.5 px"),
        ("focal length +3 %",) * 2,
        ("focal length +3 %",) * 4,
        ("focal length +3 %",) * 6,
    )
    bad_heads = (
        "bad views",
        "left out",
        "good ones left out",
        "two cameras",
        "accepted",
        "error over sigma, rms",
    )
    print_rows(bad_heads, [_spoil(case) for case in cases])


def _measure(views: str, warp: str, shape: Shape, count: int, tilt_deg: float) -> list[str]:
    board = SimulatedBoard(height_mm=shape)
    found = [
        _calibrate(
            board, draw_views(CAMERA, board, count, np.random.default_rng((count, draw)), tilt_deg=tilt_deg)
        )
        for draw in range(DRAWS)
    ]
    known = [lens for lens in found if lens.sigma["fx"] is not None]
    errors = np.array([[getattr(lens, name) - getattr(CAMERA, name) for name in COMPARED] for lens in known])
    sigmas = np.array([[lens.sigma[name] for name in COMPARED] for lens in known], dtype=float)
    heights = np.array([(w.row_mm, w.sigma_row_mm) for w in (lens.board_warp for lens in known) if w])
    error, sigma = (np.sqrt(np.mean(values**2, axis=0)) for values in (errors, sigmas))
    return [
        views,
        warp,
        f"{error[0]:.2f}",
        f"{sigma[0]:.2f}",
        *(_state_ratio(ratio, len(known)) for ratio in sigma / error),
        f"{heights[:, 0].mean():+.3f}",
        f"{np.median(heights[:, 1]):.3f}",
        f"{sum(lens.accepted for lens in found)}",
    ]


def _state_ratio(ratio: float, draws: int) -> str:
    """Return a stated over an actual standard deviation, and its 95 % interval if the latter is of so many draws."""
    low, high = ratio * np.sqrt(chi2.ppf((0.025, 0.975), draws) / draws)
    return f"{ratio:.2f} ({low:.2f}-{high:.2f})"


def _calibrate(board: SimulatedBoard, views: Sequence[FloatArray]) -> Intrinsics:
    return calibrate_intrinsics([board.points_mm] * len(views), views, CAMERA.size)


def _spoil(bad: tuple[str, ...]) -> list[str]:
    good = SimulatedBoard(height_mm=SLIGHT)
    found = []
    for draw in range(BAD_DRAWS):
        random = np.random.default_rng((len(bad), draw))
        views = [_draw_bad(name, random) for name in bad]
        found.append(_calibrate(good, views + draw_views(CAMERA, good, 12 - len(bad), random)))
    left_out = np.array([[not view.used for view in lens.views] for lens in found])
    accepted = [lens for lens in found if lens.accepted]
    errors = np.array([(lens.fx - CAMERA.fx) / (lens.sigma["fx"] or np.nan) for lens in accepted])
    return [
        " + ".join(f"{bad.count(name)} {name}" for name in dict.fromkeys(bad)) or "none",
        f"{left_out[:, : len(bad)].sum()} of {BAD_DRAWS * len(bad)}",
        f"{left_out[:, len(bad) :].sum()}",
        f"{sum('two cameras' in ' '.join(lens.reasons) for lens in found)}",
        f"{len(accepted)}",
        f"{np.sqrt(np.mean(errors**2)):.2f}" if accepted else "",
    ]


def _draw_bad(name: str, random: np.random.Generator) -> FloatArray:
    """Return a view of a board that was bent by hand, of another focal length, of a moving camera, or noisy."""
    shapes: dict[str, Shape] = {
        "bent by 3 mm": parabolas(3.0, 0.0),
        "bent by -3 mm": parabolas(-3.0, 0.0),
        "twisted by 3 mm": lambda x, y: 3.0 * x * y,
    }
    longer = replace(CAMERA, fx=1.03 * CAMERA.fx, fy=1.03 * CAMERA.fy)
    camera = longer if name == "focal length +3 %" else CAMERA
    board = SimulatedBoard(height_mm=shapes.get(name, SLIGHT))
    noise_px = 1.0 if name == "noise of 1 px" else 0.15
    view = draw_views(camera, board, 1, random, noise_px=noise_px)[0]
    if name == "rolling shutter, 1.5 px":
        # The camera accelerates sideways by 6 px while the rows of the board are read.
        v = (view[:, 1] - view[:, 1].mean()) / np.ptp(view[:, 1])
        view[:, 0] += 6.0 * v**2
    return np.clip(view, 0.0, np.array(CAMERA.size) - 1.0)
