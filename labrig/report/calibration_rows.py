"""The accuracy of the lens and the steering plane of a run, as rows of its page."""

from labrig.analysis.pictures import load_lens, load_plane_map
from labrig.record.reader import Run
from labrig.report.formatting import Rows, number, signed
from labrig.vision.intrinsics import Intrinsics
from labrig.vision.plane import PlaneMap


def describe_calibration(run: Run) -> Rows:
    """Return the accuracy of lens and plane."""
    return (*_list_lens_rows(load_lens(run)), *_list_plane_rows(load_plane_map(run)))


def _list_lens_rows(lens: Intrinsics | None) -> Rows:
    if lens is None:
        return (("lens", "no intrinsics: the pictures are assumed to be rectified"),)
    return (
        ("image size", f"{lens.image_size[0]} x {lens.image_size[1]} px"),
        *(
            (name, f"{number(getattr(lens, name), 3)} ± {number(lens.sigma.get(name), 3)} px (1 sigma)")
            for name in ("fx", "fy", "cx", "cy")
        ),
        *((("1 sigma", lens.sigma_sentence()),) if lens.sigma.get("fx") is not None else ()),
        ("k1, k2, p1, p2, k3", ", ".join(signed(value, 5) for value in lens.distortion)),
        *(() if lens.board_warp is None else (("board", lens.board_warp.sentence()),)),
        (
            "reprojection error, rms",
            f"{number(lens.rms_px, 3)} px; held out {number(lens.holdout_rms_px, 3)} px",
        ),
    )


def _list_plane_rows(plane: PlaneMap) -> Rows:
    view = plane.view_sentence()
    return (
        ("scale at the origin", f"{plane.mm_per_px:.5f} mm/px"),
        *(() if view is None else (("what the scale implies", view),)),
        (
            "plane residual, rms",
            f"{number(plane.rms_mm, 4)} mm; held out {number(plane.holdout_rms_mm, 4)} mm",
        ),
        ("insertion in the picture", plane.insertion),
        *(("assumed", sentence) for sentence in plane.assumptions()),
        *((("not in the interval", ", ".join(unknown)),) if (unknown := plane.not_in_interval()) else ()),
    )
