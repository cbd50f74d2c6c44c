"""camera_calibration: the lens by a chessboard (Zhang 1999), the steering plane by graph paper."""

from labrig.experiments.declaration import ExperimentDeclaration

EXPERIMENT = ExperimentDeclaration(
    name="camera-calibration",
    title="Camera calibration",
    protocol="labrig.experiments.camera_calibration.protocol:CameraCalibrationProtocol",
    result="labrig.experiments.camera_calibration.result:CalibrationResult",
    procedure="labrig.experiments.camera_calibration.procedure:run",
    analyze="labrig.experiments.camera_calibration.analysis:analyze",
    page="labrig.experiments.camera_calibration.page:make_page",
    reanalysis_keys=("plane",),
    summary="labrig.experiments.camera_calibration.result:summarise",
)
