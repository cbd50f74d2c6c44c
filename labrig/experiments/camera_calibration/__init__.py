"""camera_calibration: the lens by a chessboard (Zhang 1999), the steering plane by graph paper."""

from labrig.runner.experiment import Experiment

EXPERIMENT = Experiment("camera-calibration", __name__, "Camera calibration", reanalysis_keys=("plane",))
