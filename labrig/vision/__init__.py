"""vision: pixels to mm: camera model, calibration, plane map, shaft, tip and curvature.

Everything here is a pure function of pictures and numbers; only `read_picture` and the calibration files
touch the disk. The same functions serve the live run and later reanalysis.
"""

from labrig.vision.zhang import calibrate_intrinsics

__all__ = ["calibrate_intrinsics"]
