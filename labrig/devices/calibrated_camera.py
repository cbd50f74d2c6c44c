"""Whether the camera is set as it was when it was calibrated: focus and format decide where a point falls."""

from collections.abc import Iterator, Mapping
from pathlib import Path

from labrig.devices.camera_settings import HELD_BY_CALIBRATION, Setting
from labrig.devices.rig_file import RigDescription
from labrig.errors import InputError
from labrig.vision.calibration_file import read_camera


def require_calibrated_camera(rig: RigDescription, path: Path, in_use: Mapping[str, Setting]) -> None:
    """Refuse a calibration that was made with another focus or format than the camera has now.

    A setting that only one of both knows, and a calibration that states no settings, cannot be compared. Pictures that
    were recorded before are those of another camera, whose settings are not known.

    Parameters
    ----------
    rig : RigDescription
        The rig.
    path : Path
        File of the calibration.
    in_use : Mapping
        Settings of the rig's camera now.

    Raises
    ------
    InputError
        Names the first setting that differs, its value then and its value now.
    """
    made_with = {} if rig.camera.recorded else _read_settings(path)
    for name in HELD_BY_CALIBRATION:
        if name in made_with and name in in_use and made_with[name] != in_use[name]:
            raise InputError(
                f"{path.name} was made with camera.{name} {made_with[name]}, it is {in_use[name]} now",
                f"write camera.{name}: {made_with[name]} in the rig file, or calibrate again",
            )


def list_other_changes(path: Path, in_use: Mapping[str, Setting]) -> Iterator[str]:
    """Yield the settings that have changed since a calibration and do not void it, each with both values."""
    for name, then in _read_settings(path).items():
        if name in in_use and in_use[name] != then and name not in HELD_BY_CALIBRATION:
            yield f"{name} was {then}, is {in_use[name]}"


def _read_settings(path: Path) -> Mapping[str, Setting]:
    """Return the settings with which a calibration was made; nothing if they are unknown."""
    camera = read_camera(path)
    return {} if camera is None else camera.settings
