"""vision: pixels to mm: camera model, calibration, plane map, shaft, tip and curvature.

Everything here is a pure function of pictures and numbers; only `read_picture` and the calibration files
touch the disk. The same functions serve the live run and later reanalysis.
"""

from labrig.vision.boards import BoardSearch, Charuco, board_points_mm, find_board, find_board_corners
from labrig.vision.bundle import LensModel
from labrig.vision.calibration_file import (
    calibration_created,
    load_intrinsics,
    load_plane,
    save_intrinsics,
    save_plane,
)
from labrig.vision.curvature import CurvatureMeasurement, CurvatureSettings, measure_curvature
from labrig.vision.grid_check import GridCheck, GridDrift, check_grid, compare_grids
from labrig.vision.intrinsics import Intrinsics, ViewResidual
from labrig.vision.lens_evidence import LARGEST_PROJECTION_SIGMA_PX, WORKING_MARGIN
from labrig.vision.mask import Mask, load_mask
from labrig.vision.overlay import DrawnPlan, draw_plan
from labrig.vision.picture import (
    PICTURE_SUFFIXES,
    Picture,
    as_grey,
    number_order,
    read_picture,
    require_size,
    size_of,
)
from labrig.vision.plane import Insertion, PlaneMap
from labrig.vision.plane_calibration import calibrate_plane
from labrig.vision.projection import projection_sigma_px
from labrig.vision.refraction import Gel, PaperPlace
from labrig.vision.shaft_tip import ShaftTip, measure_shaft_tip
from labrig.vision.sheath import SheathPose, measure_sheath
from labrig.vision.template_file import load_template, save_template, template_files
from labrig.vision.tip import TipFix, TipSettings, locate_tip, next_region_px
from labrig.vision.tip_template import TipTemplate, cut_template
from labrig.vision.zhang import calibrate_from_pictures, calibrate_intrinsics

__all__ = [
    "LARGEST_PROJECTION_SIGMA_PX",
    "PICTURE_SUFFIXES",
    "WORKING_MARGIN",
    "BoardSearch",
    "Charuco",
    "CurvatureMeasurement",
    "CurvatureSettings",
    "DrawnPlan",
    "Gel",
    "GridCheck",
    "GridDrift",
    "Insertion",
    "Intrinsics",
    "LensModel",
    "Mask",
    "PaperPlace",
    "Picture",
    "PlaneMap",
    "ShaftTip",
    "SheathPose",
    "TipFix",
    "TipSettings",
    "TipTemplate",
    "ViewResidual",
    "as_grey",
    "board_points_mm",
    "calibrate_from_pictures",
    "calibrate_intrinsics",
    "calibrate_plane",
    "calibration_created",
    "check_grid",
    "compare_grids",
    "cut_template",
    "draw_plan",
    "find_board",
    "find_board_corners",
    "load_intrinsics",
    "load_mask",
    "load_plane",
    "load_template",
    "locate_tip",
    "measure_curvature",
    "measure_shaft_tip",
    "measure_sheath",
    "next_region_px",
    "number_order",
    "projection_sigma_px",
    "read_picture",
    "require_size",
    "save_intrinsics",
    "save_plane",
    "save_template",
    "size_of",
    "template_files",
]
