"""The intrinsics of known photographs and corners beside their published values, and what is refused."""

from pathlib import Path

import numpy as np

from labrig.vision.boards import BoardSearch
from labrig.vision.intrinsics import Intrinsics
from labrig.vision.picture import read_picture
from labrig.vision.projection import projection_sigma_px
from labrig.vision.zhang import calibrate_from_pictures, calibrate_intrinsics
from tests.benchmarks.table import print_rows

DATA = Path(__file__).parents[3] / "shared" / "data"
LEFT = {"fx": (532.83, 0.44), "fy": (532.95, 0.46), "cx": (342.49, 0.46), "cy": (233.86, 0.51)}
# mrcal 2.2 with OpenCV's five coefficients, without regularisation, on the corners that labrig finds: with the board's
# warp, and of a flat board.
MRCAL = (533.2582, 533.38, 342.0852, 234.2647, -0.2814055, 0.03508815, 0.001045154, -0.0001140617, 0.1388458)
MRCAL_FLAT = (
    533.0765,
    533.1386,
    342.1873,
    234.0728,
    -0.2848129,
    0.05821334,
    0.001075405,
    -9.245688e-5,
    0.09161326,
)
ZHANG = {
    "fx": 832.5,
    "skew": 0.204494,
    "cx": 303.959,
    "fy": 832.53,
    "cy": 206.585,
    "k1": -0.228601,
    "k2": 0.190353,
}
PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "skew")


def print_table() -> None:
    """Print OpenCV's left set beside published values and mrcal's, Zhang's five views, and what must be refused.

    mrcal's fit of a flat board shows what the warp changes: k1 by 0.32 sigma, which is mrcal's own change too.
    """
    if not DATA.is_dir():
        print(f"skipped: {DATA} is not here")
        return
    pictures = [(path.name, read_picture(path)) for path in sorted((DATA / "opencv_chess").glob("left*.jpg"))]
    found = calibrate_from_pictures(pictures, 9, 6, 25.0)
    rows = [
        [
            f"left set {name}, px",
            f"{getattr(found, name):.2f}",
            known,
            f"{(getattr(found, name) - known) / sigma:+.2f} sigma",
            "2",
        ]
        for name, (known, sigma) in LEFT.items()
    ]
    for what, mrcal, limit in (("mrcal's", MRCAL, "0.02"), ("mrcal's of a flat board", MRCAL_FLAT, "0.3")):
        rows += [
            [
                f"left set {name} beside {what}",
                f"{value:.5f}",
                f"{known:.5f}",
                f"{(value - known) / (found.sigma[name] or np.nan):+.2f} sigma",
                limit,
            ]
            for name, value, known in zip(PARAMETERS[:-1], found.parameters()[:-1], mrcal, strict=True)
        ]
    forced = calibrate_from_pictures(pictures, 9, 6, 25.0, search=BoardSearch(window_px=11))
    flagged = ", ".join(view.image for view in forced.views if not view.used)
    rows.append(["left set, window of 11 forced", flagged or "none", "left02.jpg", "", "flagged"])
    rows += [
        [f"Zhang's {name}", f"{value:.6f}", ZHANG[name], f"{value - ZHANG[name]:+.6f}", "0.01"]
        for name, value in _zhang()
    ]
    cut = _cut_boards()
    for what, lens in (
        ("one photograph five times", calibrate_from_pictures([pictures[0]] * 5, 9, 6, 25.0)),
        ("20 photographs of a board all but parallel, cut by the frame", cut),
    ):
        rows.append([what, "accepted" if lens.accepted else "refused", "refused", "", "refused"])
    print_rows(("figure", "measured", "known", "off", "limit"), rows)
    corners = np.vstack([view.corners_px for view in found.views])
    centre = np.array(found.projection_sigma_px)[3, 4]
    at = projection_sigma_px(found, [(100.0, 100.0)], corners)[0]
    print(
        f"{len(corners)} corners; uncertain by {centre:.3f} px in the middle (mrcal: 0.026) and "
        f"{at:.2f} px at (100, 100) (mrcal: 0.14); predicted to {found.holdout_rms_px:.3f} px"
    )
    print(
        f"the cut boards: {sum(view.used for view in cut.views)} of {len(cut.views)} used, fx {cut.fx:.0f} +- "
        f"{cut.sigma['fx']:.0f} px, predicted to {cut.holdout_rms_px:.2f} px"
    )
    for reason in cut.reasons:
        print(f"  {reason}")


def _zhang() -> list[tuple[str, float]]:
    board = np.loadtxt(DATA / "zhang" / "Model.txt").reshape(-1, 2) * 25.4
    views = [np.loadtxt(path).reshape(-1, 2) for path in sorted((DATA / "zhang").glob("data*.txt"))]
    found = calibrate_intrinsics([board] * len(views), views, (640, 480), model="zhang")
    return [
        (name, value) for name, value in zip(PARAMETERS, found.parameters(), strict=True) if name in ZHANG
    ]


def _cut_boards() -> Intrinsics:
    folder = DATA / "real_insertions" / "checkerboard"
    pictures = [(path.name, read_picture(path)) for path in sorted(folder.glob("*.jpg"))]
    return calibrate_from_pictures(pictures, 9, 6, 25.0, search=BoardSearch(partial=True))
