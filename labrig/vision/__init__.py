"""vision: pixels to mm: camera model, calibration, plane map, shaft, tip and curvature.

Everything here is a pure function of pictures and numbers; only pictures, masks, templates and calibrations are read
from or written to disk. A live run and a later reanalysis call the same functions.
"""

from labrig.vision.zhang import calibrate_intrinsics

__all__ = ["calibrate_intrinsics"]
