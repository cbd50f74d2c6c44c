"""vision: pixels to mm: camera model, calibration, plane map, shaft, tip and curvature.

Everything here is a pure function of pictures and numbers; only pictures, masks, templates and calibrations are read
from or written to disk. A live run and a later reanalysis call the same functions.
"""

from labrig.vision.calibrate_lens import calibrate_intrinsics
from labrig.vision.calibration_file import load_intrinsics, load_plane
from labrig.vision.circle import fit_circle

__all__ = ["calibrate_intrinsics", "fit_circle", "load_intrinsics", "load_plane"]
