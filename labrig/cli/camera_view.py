"""What `labrig devices camera` does: takes pictures, scores each, and shows them at the terminal or in a browser."""

import sys
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import IO, cast

from labrig.cli.calibration_files import require_writable
from labrig.cli.camera_watch import CameraWatch, ScoredPicture, Show
from labrig.cli.output import (
    SafeStandardError,
    escape_controls,
    print_checks,
    print_line,
    say,
    show,
)
from labrig.cli.signals import note_signals
from labrig.devices.camera import Camera, require_calibrated_camera
from labrig.devices.hardware import open_camera
from labrig.devices.rig_file import RigDescription
from labrig.durable import write_atomically
from labrig.errors import InputError
from labrig.report.picture_page import PicturePage, ShownPicture
from labrig.report.web_page import suggest_forwarding
from labrig.runner.sight import load_plane_map
from labrig.vision.camera_frame import CameraInUse, encode_frame
from labrig.vision.landmarks import Landmark, find_landmarks
from labrig.vision.picture import Picture
from labrig.vision.picture_quality import Score
from labrig.vision.plane import PlaneMap

_INTERRUPTED = 130
_COUNTED = 16
_SHEATH_MM = 2.0
"""Outer diameter of the sheath that is searched, within a factor of about 1.5."""
_STATUS = {True: "PASS", False: "FAIL", None: "WARN"}


@dataclass(frozen=True)
class CameraOrder:
    """What to look at, and how.

    Attributes
    ----------
    rig : RigDescription
    web : bool
        Whether a page is served.
    pictures : int or None
        How many pictures; None: until interrupted, or a default number where nobody could interrupt.
    save : Path or None
        Where the last picture is written.
    as_json : bool
    """

    rig: RigDescription
    web: bool
    pictures: int | None
    save: Path | None
    as_json: bool

    @property
    def wanted(self) -> int | None:
        """How many pictures are taken; None: until interrupted."""
        watched = self.web or (sys.stdout.isatty() and not self.as_json and self.save is None)
        return self.pictures if self.pictures is not None or watched else _COUNTED


def view_camera(order: CameraOrder) -> int:
    """Show the camera of a rig, and return the exit code.

    Raises
    ------
    InputError
        When the file for the picture cannot be written.
    LockedError, CameraError
        When the camera cannot be opened, or gives no picture.
    """
    _require_png(order.save)
    require_writable(order.save, force=False, hint="choose another name")
    with ExitStack() as stack:
        interrupted = stack.enter_context(note_signals())
        camera = stack.enter_context(open_camera(order.rig, "labrig devices camera"))
        shows = stack.enter_context(_open_shows(order, camera))
        watch = CameraWatch(camera, order.wanted, interrupted, shows)
        search = partial(_search, order, camera)
        if order.wanted is None or order.web:
            watch.search(search)
        while not watch.has_ended:
            watch.step()
    if watch.last is None:
        return _INTERRUPTED
    if not watch.landmarks and watch.interrupted() is None:
        watch.landmarks = search(watch.last.image)
    _report(order, watch, camera)
    _save(order.save, watch.last.image, _describe_camera(order.rig, camera))
    if watch.interrupted() is not None:
        return _INTERRUPTED
    return 1 if any(score.good is False for score in watch.last.scores) else 0


def _search(order: CameraOrder, camera: Camera, image: Picture) -> tuple[Landmark, ...]:
    return find_landmarks(image, partial(_load_valid_plane, order.rig, camera), _SHEATH_MM)


def _load_valid_plane(rig: RigDescription, camera: Camera) -> PlaneMap:
    """Return the rig's plane map if the camera is set as it was then. Raises `InputError`."""
    for path in rig.calibration_paths().values():
        require_calibrated_camera(rig.camera, path, camera.settings.in_use)
    return load_plane_map(rig)


# Showing


@contextmanager
def _open_shows(order: CameraOrder, camera: Camera) -> Iterator[Show]:
    """Open what shows pictures while they are taken: a page, a table on a terminal, both, or nothing."""
    with ExitStack() as stack:
        shows: list[Show] = []
        if order.web:
            page = stack.enter_context(closing(PicturePage()))
            say(f"open {page.url}\nfrom another computer first: {suggest_forwarding(page.port)}")
            heading, camera_of_rig = f"Camera of rig {order.rig.name}", _describe_camera(order.rig, camera)

            def show_in_page(picture: ScoredPicture, landmarks: tuple[Landmark, ...]) -> None:
                page.show(
                    ShownPicture(
                        picture.number,
                        picture.image,
                        heading,
                        scores=picture.scores,
                        landmarks=landmarks,
                        camera=camera_of_rig,
                    )
                )

            shows.append(show_in_page)
        if sys.stdout.isatty() and not order.as_json and order.wanted is None:
            shows.append(stack.enter_context(_open_table()))

        def show_all(picture: ScoredPicture, landmarks: tuple[Landmark, ...]) -> None:
            for each in shows:
                each(picture, landmarks)

        yield show_all


@contextmanager
def _open_table() -> Iterator[Show]:
    """Keep a table on the terminal up to date; it is gone in the end."""
    from rich.console import Console
    from rich.live import Live
    from rich.table import Table
    from rich.text import Text

    console = Console(file=cast("IO[str]", SafeStandardError()))
    with Live(console=console, refresh_per_second=8, transient=True) as live:

        def show_row(picture: ScoredPicture, landmarks: tuple[Landmark, ...]) -> None:
            table = Table.grid(padding=(0, 2))
            table.add_row("", f"picture {picture.number}; Ctrl+C ends")
            for check in _list_checks(picture.scores):
                value = "\n".join(filter(None, (f"{check['check']}: {check['value']}", check["solution"])))
                table.add_row(check["status"], Text(escape_controls(value)))
            for landmark in landmarks:
                table.add_row("", Text(escape_controls(_describe(landmark))))
            live.update(table)

        yield show_row


def _list_checks(scores: tuple[Score, ...]) -> list[dict[str, str]]:
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


def _report(order: CameraOrder, watch: CameraWatch, camera: Camera) -> None:
    """Print the scores of the last picture; as JSON those of all, if their number was given."""
    assert watch.last is not None
    document = {
        "rig": order.rig.name,
        "camera": _describe_camera(order.rig, camera).model_dump(),
        "ok": False not in [score.good for score in watch.last.scores],
        "pictures": watch.taken,
        "landmarks": [asdict(mark) for mark in watch.landmarks],
    }
    show(document, order.as_json, lambda _: _print(order, watch, watch.last))


def _print(order: CameraOrder, watch: CameraWatch, last: ScoredPicture | None) -> None:
    if last is not None:
        print_line(f"picture {last.number} of rig {order.rig.name}")
        print_checks(_list_checks(last.scores), as_json=False)
    for landmark in watch.landmarks:
        print_line(f"      {_describe(landmark)}", 6)


def _describe_camera(rig: RigDescription, camera: Camera) -> CameraInUse:
    """Return the camera as a calibration keeps it."""
    return CameraInUse(driver=rig.camera.driver, device=rig.camera.address, settings=camera.settings.in_use)


def _require_png(save: Path | None) -> None:
    if save is not None and save.suffix.lower() != ".png":
        raise InputError(f"--save {save} is no PNG file", "give a name that ends in .png")


def _save(path: Path | None, image: Picture, camera: CameraInUse) -> None:
    """Write a test frame. Raises `OutputExistsError` if somebody has made a file of that name meanwhile."""
    if path is None:
        return
    require_writable(path, force=False, hint="choose another name")
    write_atomically(path, encode_frame(image, camera))
    say(f"written: {path}")
