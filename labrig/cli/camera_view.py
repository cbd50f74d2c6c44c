"""What `labrig devices camera` does: takes pictures, scores each, and shows them in a browser."""

from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import asdict
from functools import partial
from pathlib import Path

from labrig.cli.calibration_files import require_writable
from labrig.cli.camera_watch import CameraWatch
from labrig.cli.output import print_checks, print_line, say, show
from labrig.cli.signals import note_signals
from labrig.devices.camera import Camera, require_calibrated_camera
from labrig.devices.hardware import open_camera
from labrig.devices.rig_file import RigDescription
from labrig.durable import write_atomically
from labrig.errors import InputError
from labrig.report.local_server import suggest_forwarding
from labrig.report.picture_page import NO_PICTURE, PicturePage, ShownPicture
from labrig.runner.sight import load_plane_map
from labrig.vision.calibration_file import CameraInUse, encode_frame
from labrig.vision.drawing import Landmark, find_landmarks
from labrig.vision.picture_quality import Score
from labrig.vision.plane import PlaneMap

_INTERRUPTED = 130
_COUNTED = 16
_SHEATH_MM = 2.0
"""Outer diameter of the sheath that is searched, within a factor of about 1.5."""
_STATUS = {True: "PASS", False: "FAIL", None: "WARN"}


def view_camera(
    rig: RigDescription, *, web: bool, pictures: int | None, save: Path | None, as_json: bool
) -> int:
    """Show the camera of a rig, and return the exit code.

    Parameters
    ----------
    web : bool
        Whether a page is served.
    pictures : int or None
        How many; None: until interrupted with a page, else a default number.
    save : Path or None
        Where the last picture is written.

    Raises
    ------
    InputError
        When the file for the picture cannot be written.
    LockedError, CameraError
        When the camera cannot be opened, or gives no picture.
    """
    _require_new_png(save)
    wanted = pictures if pictures is not None or web else _COUNTED
    with ExitStack() as stack:
        interrupted = stack.enter_context(note_signals())
        camera = stack.enter_context(open_camera(rig, "labrig devices camera"))
        in_use = CameraInUse(
            driver=rig.camera.driver, device=rig.camera.address, settings=camera.settings.in_use
        )
        page = stack.enter_context(closing(_serve_page())) if web else None
        shown = ShownPicture(0, NO_PICTURE, f"Camera of rig {rig.name}", camera=in_use)
        watch = CameraWatch(camera, shown, wanted, interrupted, page)
        search = partial(
            find_landmarks, plane=partial(_load_valid_plane, rig, camera), sheath_diameter_mm=_SHEATH_MM
        )
        if web:
            watch.search(search)
        while not watch.has_ended:
            watch.step()
    last = watch.last
    if last is None:
        return _INTERRUPTED
    if not watch.landmarks and watch.interrupted() is None:
        watch.landmarks = search(last.image)
    is_good = False not in [score.good for score in last.scores]
    document = {
        "rig": rig.name,
        "camera": in_use.model_dump(),
        "ok": is_good,
        "pictures": watch.taken,
        "landmarks": [asdict(mark) for mark in watch.landmarks],
    }
    show(document, as_json, lambda _: _print(rig, last, watch.landmarks))
    if save is not None:
        _require_new_png(save)  # somebody may have made it meanwhile
        write_atomically(save, encode_frame(last.image, in_use))
        say(f"written: {save}")
    if watch.interrupted() is not None:
        return _INTERRUPTED
    return 0 if is_good else 1


def _serve_page() -> PicturePage:
    page = PicturePage()
    say(f"open {page.url}\nfrom another computer first: {suggest_forwarding(page.port)}")
    return page


def _require_new_png(save: Path | None) -> None:
    if save is not None and save.suffix.lower() != ".png":
        raise InputError(f"--save {save} is no PNG file", "give a name that ends in .png")
    require_writable(save, force=False, hint="choose another name")


def _load_valid_plane(rig: RigDescription, camera: Camera) -> PlaneMap:
    """Return the rig's plane map if the camera is set as it was then. Raises `InputError`."""
    for path in rig.calibration_paths().values():
        require_calibrated_camera(rig.camera, path, camera.settings.in_use)
    return load_plane_map(rig)


def _list_checks(scores: Sequence[Score]) -> list[dict[str, str]]:
    """Return scores as checks."""
    return [
        {
            "status": _STATUS[score.good],
            "check": score.name,
            "value": f"{score.text} ({score.limit})",
            "solution": score.hint,
        }
        for score in scores
    ]


def _describe(landmark: Landmark) -> str:
    return f"{landmark.name}: {landmark.text if landmark.found else f'not found: {landmark.text}'}"


def _print(rig: RigDescription, last: ShownPicture, landmarks: Sequence[Landmark]) -> None:
    print_line(f"picture {last.number} of rig {rig.name}")
    print_checks(_list_checks(last.scores), as_json=False)
    for landmark in landmarks:
        print_line(f"      {_describe(landmark)}", 6)
