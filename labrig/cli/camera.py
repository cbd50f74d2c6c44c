"""What `labrig devices camera` does: takes pictures, scores each, and shows them in a browser."""

from collections import deque
from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict, replace
from itertools import count, islice
from pathlib import Path

from labrig.cli.calibration_files import require_writable
from labrig.cli.output import print_checks, print_json, print_line, say
from labrig.cli.signals import SignalNote, note_signals
from labrig.devices.camera import Camera
from labrig.devices.clocks import SystemClock
from labrig.devices.hardware import open_camera
from labrig.devices.rig_file import RigDescription
from labrig.durable import write_atomically
from labrig.errors import InputError, InterruptedRunError
from labrig.report.local_server import suggest_forwarding
from labrig.report.picture_page import NO_PICTURE, PicturePage, ShownPicture
from labrig.vision.calibration_file import CameraInUse, encode_frame
from labrig.vision.picture_quality import judge_picture, measure_flicker

_COUNTED = 16
_REMEMBERED = 64
_PERIOD_S = 0.1
"""Shortest time between two pictures that a person watches: nobody sees more, and a simulated camera has no rate."""
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
        taken = _show(pictures) if web else list(islice(pictures, _COUNTED))
        if not taken:
            return InterruptedRunError.exit_code
        last = taken[-1]
    is_good = all(score.good is not False for score in last.scores)
    print_json({
        "rig": rig.name,
        "camera": in_use.model_dump(),
        "ok": is_good,
        "pictures": [
            {"picture": one.number, "scores": [asdict(score) for score in one.scores]} for one in taken
        ],
    })  # fmt: skip
    _print(rig, last)
    if save is not None:
        _require_new_png(save)  # somebody may have made it meanwhile
        write_atomically(save, encode_frame(last.image, in_use))
        say(f"written: {save}")
    if interrupted() is not None:
        return InterruptedRunError.exit_code
    return 0 if is_good else 1


def _take_pictures(camera: Camera, shown: ShownPicture, interrupted: SignalNote) -> Iterator[ShownPicture]:
    """Yield pictures with their scores until a signal has come."""
    times_s: deque[float] = deque(maxlen=_REMEMBERED)
    means: deque[float] = deque(maxlen=_REMEMBERED)
    for number in count(1):
        if interrupted() is not None:
            return
        frame = camera.capture()
        times_s.append(frame.t_s)
        means.append(float(frame.image.mean()))
        scores = judge_picture(frame.image, measure_flicker(times_s, means))
        yield replace(shown, number=number, image=frame.image, scores=scores)


def _show(pictures: Iterator[ShownPicture]) -> list[ShownPicture]:
    """Show pictures in a browser to their end; return the last."""
    clock, last = SystemClock(), []
    with closing(PicturePage()) as page:
        say(f"open {page.url}\n{suggest_forwarding(page.port)}")
        for picture in pictures:
            last = [picture]
            page.show(picture)
            clock.sleep(_PERIOD_S)
    return last


def _require_new_png(save: Path | None) -> None:
    if save is not None and save.suffix.lower() != ".png":
        raise InputError(f"--save {save} is no PNG file", "give a name that ends in .png")
    require_writable(save, force=False, hint="choose another name")


def _print(rig: RigDescription, last: ShownPicture) -> None:
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
