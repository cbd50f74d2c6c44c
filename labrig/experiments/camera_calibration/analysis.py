"""The camera's lens and the steering plane, from the pictures of a camera calibration run."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from labrig.analysis.experiment import AnalysisRequest
from labrig.analysis.pictures import INTRINSICS_FILE, PLANE_FILE, Progress
from labrig.analysis.result import Findings, Point
from labrig.errors import CalibrationRefusedError, MeasurementRefusedError, PictureError, RecordError
from labrig.experiments.camera_calibration.events import CalibrationRole
from labrig.experiments.camera_calibration.protocol import SCALE_HINT, CameraCalibrationProtocol, GraphPaper
from labrig.experiments.camera_calibration.result import CalibrationResult
from labrig.record.reader import Run
from labrig.vision.calibrate_lens import calibrate_from_pictures, find_board
from labrig.vision.calibrate_plane import calibrate_plane, find_px_per_mm
from labrig.vision.calibration_file import CAMERA, CameraInUse, load_px_per_mm, save_intrinsics, save_plane
from labrig.vision.intrinsics import Intrinsics
from labrig.vision.picture import Picture
from labrig.vision.plane import PlaneMap

Named = tuple[str, Picture]


def analyze(run: Run, protocol: CameraCalibrationProtocol, request: AnalysisRequest) -> Findings:
    """Calibrate the lens from the photographs of the board, then the plane from that of the graph paper.

    The calibrations are saved as `intrinsics.json` and `plane.json`; a refused one is marked in its file.
    """
    boards, papers = _read_pictures(run, request.progress)
    lens: Intrinsics | None = None
    plane: PlaneMap | None = None
    reasons: tuple[str, ...] = ()
    try:
        lens = _calibrate_lens(boards, protocol)
        reasons = lens.reasons
        plane = _calibrate_plane(run, papers, lens, protocol)
        reasons += plane.reasons
    except (CalibrationRefusedError, MeasurementRefusedError, PictureError) as refusal:
        reasons += (f"{refusal.message}: {refusal.hint}" if refusal.hint else refusal.message,)
    stamp = request.stamp
    content = CalibrationResult(
        **stamp.list_members({"board": protocol.board.model_dump(), "plane": protocol.plane.model_dump()}),
        accepted=lens is not None and lens.accepted and plane is not None and plane.accepted,
        reasons=reasons,
        intrinsics=None if lens is None else lens.to_json(),
        plane=None if plane is None else plane.to_json(),
        corners=_find_corners(boards, lens, protocol),
    )
    made_from = {
        "run": run.path.name,
        "created": stamp.created,
        "inputs": dict(stamp.inputs),
        **_read_camera(run),
    }
    return Findings(content, partial(_save_calibration, lens, plane, {**stamp.provenance, **made_from}))


def _save_calibration(
    lens: Intrinsics | None, plane: PlaneMap | None, provenance: Mapping[str, Any], folder: Path
) -> None:
    if lens is not None:
        save_intrinsics(folder / INTRINSICS_FILE, lens, dict(provenance))
    if plane is not None:
        save_plane(folder / PLANE_FILE, plane, dict(provenance))


def _read_camera(run: Run) -> dict[str, Any]:
    """Return the camera and its settings as the record states them; nothing if it does not."""
    devices = run.devices
    camera = devices.get("camera") if isinstance(devices, Mapping) else None
    if not isinstance(camera, Mapping) or not isinstance(camera.get("readback"), Mapping):
        return {}
    found = CameraInUse.parse({**camera, "settings": {**camera.get("reported", {}), **camera["readback"]}})
    return {} if found is None else {CAMERA: found.model_dump()}


def _read_pictures(run: Run, progress: Progress | None) -> Iterator[list[Named]]:
    """Yield the pictures of each role. One that is missing or was changed is left out."""
    found: dict[str, list[Named]] = {role: [] for role in CalibrationRole}
    for number, line in enumerate(run.frame_lines, start=1):
        with suppress(RecordError):  # the stamp of the result names it
            found.get(line.role or "", []).append((line.file, run.read_frame(line.frame)))
        if progress is not None:
            progress(number, len(run.frame_lines))
    yield from (found[role] for role in CalibrationRole)


def _calibrate_lens(boards: Sequence[Named], protocol: CameraCalibrationProtocol) -> Intrinsics:
    if not boards:
        raise MeasurementRefusedError("no picture of the board was recorded")
    board = protocol.board
    return calibrate_from_pictures(boards, board.columns, board.rows, board.square_mm)


def _calibrate_plane(
    run: Run, papers: Sequence[Named], lens: Intrinsics, protocol: CameraCalibrationProtocol
) -> PlaneMap:
    if not papers:
        raise MeasurementRefusedError("no picture of the graph paper was recorded")
    plane = protocol.plane
    px_per_mm = _find_px_per_mm(run, lens, plane)
    if px_per_mm is None:
        raise MeasurementRefusedError("nothing tells how far the camera is", SCALE_HINT)
    return calibrate_plane(
        papers[-1][1],
        lens,
        plane.pitch_mm,
        plane.origin_px,
        plane.insertion,
        px_per_mm=px_per_mm,
        gel=plane.gel,
        paper_sigma_mm=plane.paper_sigma_mm,
    )


def _find_px_per_mm(run: Run, lens: Intrinsics, plane: GraphPaper) -> float | None:
    """Return the scale of the pictures, roughly: by a distance, or of the rig's plane map when the run began."""
    camera = run.rig.get("camera")
    in_rig = camera.get("distance_mm") if isinstance(camera, Mapping) else None
    distance_mm = plane.distance_mm or (in_rig if isinstance(in_rig, float | int) else None)
    if distance_mm:
        return find_px_per_mm(lens, distance_mm)
    return load_px_per_mm(run.calibration_path(PLANE_FILE)) if PLANE_FILE in run.calibration_files else None


def _find_corners(
    boards: Sequence[Named], lens: Intrinsics | None, protocol: CameraCalibrationProtocol
) -> dict[str, tuple[Point, ...]]:
    used = {view.image for view in lens.views if view.used} if lens is not None else set()
    seen = {
        name: find_board(image, protocol.board.columns, protocol.board.rows).pixels
        for name, image in boards
        if name in used
    }
    return {
        name: tuple((round(float(u), 2), round(float(v), 2)) for u, v in pixels)
        for name, pixels in seen.items()
    }
