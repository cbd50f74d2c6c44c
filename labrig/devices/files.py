"""files: a folder of recorded pictures in place of a camera, by `driver: files`.

What is decided here
--------------------
- Recorded pictures do not show what the needle does now. They run the path of a bench without a camera. With real
  drives, an experiment whose pictures decide motion is refused.
- A folder gives its next picture for each read, picture2 before picture10.
- Only regular files in the folder are read.
"""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from labrig.devices.camera import (
    CameraContext,
    CameraDescription,
    Exposure,
    Picture,
    RigKind,
    Setting,
)
from labrig.errors import CameraError, PictureError
from labrig.vision.picture import PICTURE_SUFFIXES, number_order, read_picture, size_of


class FilesCameraDescription(CameraDescription):
    """Recorded pictures in place of a camera. They never steer."""

    rig_kinds: ClassVar[frozenset[RigKind]] = frozenset({"simulated", "bench"})
    recorded: ClassVar[bool] = True

    driver: Literal["files"]
    """files: recorded pictures in place of a camera."""
    source: Annotated[str, Field(min_length=1, max_length=1000)]
    """Folder of pictures, relative to the rig file."""

    @property
    def address(self) -> str:
        """The folder."""
        return self.source

    def settings(self) -> dict[str, Setting]:
        """Return the required size of the pictures; they have a rate of their own."""
        return {"width_px": self.width_px, "height_px": self.height_px}

    def open(self, context: CameraContext) -> "FilesSource":
        """Open the folder. Raises `CameraError`."""
        return FilesSource(context.folder / self.source)


class FilesSource:
    """The pictures of a folder, each taken once.

    Parameters
    ----------
    folder : Path
        The folder.

    Raises
    ------
    CameraError
        When the folder or its first picture cannot be read.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._paths = _list_pictures(folder)
        self._left = list(self._paths)
        width_px, height_px = size_of(_read(self._paths[0]))
        self._size = {"width_px": float(width_px), "height_px": float(height_px)}

    def set(self, name: str, value: Setting) -> None:
        """Do nothing: recorded pictures have no settings."""

    def get(self, name: str) -> Setting | None:
        """Return the width or height of the pictures."""
        return self._size.get(name)

    def read(self) -> Exposure:
        """Return the next picture. Raises `CameraError` when none is left."""
        if self._left:
            return Exposure(_read(self._left.pop(0)))
        raise CameraError(
            f"the {len(self._paths)} pictures of folder {self._folder} have ended",
            "record more pictures, or take fewer: labrig check PROTOCOL says how many a run takes",
        )

    def close(self) -> None:
        """Do nothing: no file is open."""


CAMERA = FilesCameraDescription
"""What the entry point names."""


def _list_pictures(folder: Path) -> tuple[Path, ...]:
    try:
        found = [path for path in folder.iterdir() if path.suffix.lower() in PICTURE_SUFFIXES]
    except OSError as error:
        raise CameraError(
            f"folder {folder} cannot be read: {error.strerror}", "check camera.source"
        ) from error
    for path in found:
        if path.is_symlink() or not path.is_file():
            raise CameraError(f"{path} is not a regular file", "copy the picture itself into the folder")
    if not found:
        raise CameraError(
            f"folder {folder} holds no picture", f"pictures end in {' '.join(sorted(PICTURE_SUFFIXES))}"
        )
    return tuple(sorted(found, key=number_order))


def _read(path: Path) -> Picture:
    try:
        return read_picture(path)
    except PictureError as error:
        raise CameraError(error.message, error.hint) from error
