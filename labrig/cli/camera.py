"""What `labrig devices camera` does: takes pictures, scores each, and shows them in a browser."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import asdict, replace
from functools import partial
from itertools import count, islice
from pathlib import Path

from labrig.cli.calibration_files import require_writable
from labrig.cli.output import print_checks, print_json, print_line, say
from labrig.cli.signals import SignalNote, note_signals
from labrig.devices.camera import Camera, require_calibrated_camera
from labrig.devices.clocks import SystemClock
from labrig.devices.hardware import open_camera
from labrig.devices.rig_file import RigDescription
from labrig.durable import write_atomically
from labrig.errors import InputError
from labrig.report.local_server import suggest_forwarding
from labrig.report.picture_page import NO_PICTURE, PicturePage, ShownPicture
from labrig.runner.sight import load_plane_map
from labrig.vision.calibration_file import CameraInUse, encode_frame
from labrig.vision.drawing import Landmark, find_landmarks
from labrig.vision.picture import Picture
from labrig.vision.picture_quality import judge_quality, measure_flicker, measure_quality
from labrig.vision.plane import PlaneMap

_INTERRUPTED = 130
_COUNTED = 16
_REMEMBERED = 64
_PERIOD_S = 0.1
"""Shortest time between two pictures that a person watches: nobody sees more, and a simulated camera has no rate."""
_SHEATH_MM = 2.0
"""Outer diameter of the sheath that is searched, within a factor of about 1.5."""
_STATUS = {True: "PASS", False: "FAIL", None: "WARN"}


def view_camera(rig: RigDescription, *, web: bool, save: Path | None) -> int:
    """Score pictures of a rig's camera, with a page until interrupted, and return the exit code.

    Parameters
    ----------
    web : bool
        Whether a page is served.
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
    with note_signals() as interrupted, open_camera(rig, "labrig devices camera") as camera:
        in_use = CameraInUse(driver=rig.camera.driver, device=rig.camera.address, settings=camera.settings)
        shown = ShownPicture(0, NO_PICTURE, f"Camera of rig {rig.name}", camera=in_use)
        pictures = _take_pictures(camera, shown, interrupted)
        plane = partial(_load_valid_plane, rig, camera)
        search = partial(find_landmarks, plane=plane, sheath_diameter_mm=_SHEATH_MM)
        taken = _show(pictures, search) if web else list(islice(pictures, _COUNTED))
        if not taken:
            return _INTERRUPTED
        last = taken[-1]
        landmarks = last.landmarks or (search(last.image) if interrupted() is None else ())
    is_good = all(score.good is not False for score in last.scores)
    print_json({
        "rig": rig.name,
        "camera": in_use.model_dump(),
        "ok": is_good,
        "pictures": [
            {"picture": one.number, "scores": [asdict(score) for score in one.scores]} for one in taken
        ],
        "landmarks": [asdict(mark) for mark in landmarks],
    })  # fmt: skip
    _print(rig, last, landmarks)
    if save is not None:
        _require_new_png(save)  # somebody may have made it meanwhile
        write_atomically(save, encode_frame(last.image, in_use))
        say(f"written: {save}")
    if interrupted() is not None:
        return _INTERRUPTED
    return 0 if is_good else 1


def _take_pictures(camera: Camera, shown: ShownPicture, interrupted: SignalNote) -> Iterator[ShownPicture]:
    """Yield pictures with their scores until a signal has come."""
    times_s: deque[float] = deque(maxlen=_REMEMBERED)
    means: deque[float] = deque(maxlen=_REMEMBERED)
    for number in count(1):
        if interrupted() is not None:
            return
        frame = camera.capture()
        quality = measure_quality(frame.image)
        times_s.append(frame.t_s)
        means.append(quality.mean_grey)
        scores = judge_quality(quality, measure_flicker(times_s, means))
        yield replace(shown, number=number, image=frame.image, scores=scores)


def _show(
    pictures: Iterator[ShownPicture], search: Callable[[Picture], tuple[Landmark, ...]]
) -> list[ShownPicture]:
    """Show pictures in a browser to their end, while landmarks are searched in one beside that; return the last."""
    clock, searching, last = SystemClock(), Future[tuple[Landmark, ...]](), []
    searching.set_result(())
    # The end waits for the search, a second or two: a thread that is inside OpenCV when Python ends aborts it.
    with closing(PicturePage()) as page, ThreadPoolExecutor(1) as worker:
        say(f"open {page.url}\nfrom another computer first: {suggest_forwarding(page.port)}")
        landmarks: tuple[Landmark, ...] = ()
        for picture in pictures:
            if searching.done():
                landmarks = searching.result()
                searching = worker.submit(search, picture.image)
            last = [replace(picture, landmarks=landmarks)]
            page.show(last[0])
            clock.sleep(_PERIOD_S)
    return last


def _require_new_png(save: Path | None) -> None:
    if save is not None and save.suffix.lower() != ".png":
        raise InputError(f"--save {save} is no PNG file", "give a name that ends in .png")
    require_writable(save, force=False, hint="choose another name")


def _load_valid_plane(rig: RigDescription, camera: Camera) -> PlaneMap:
    """Return the rig's plane map if the camera is set as it was then. Raises `InputError`."""
    for path in rig.calibration_paths().values():
        require_calibrated_camera(rig.camera, path, camera.settings)
    return load_plane_map(rig)


def _print(rig: RigDescription, last: ShownPicture, landmarks: Sequence[Landmark]) -> None:
    print_line(f"picture {last.number} of rig {rig.name}")
    print_checks([
        {
            "status": _STATUS[score.good],
            "check": score.name,
            "value": f"{score.text} ({score.limit})",
            "solution": score.hint,
        }
        for score in last.scores
    ])  # fmt: skip
    for mark in landmarks:
        print_line(f"      {mark.name}: {'' if mark.found else 'not found: '}{mark.text}", 6)
