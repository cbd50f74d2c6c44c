"""Loads the calibration of a rig's camera, and refuses dark pictures."""

from labrig.devices.rig_file import RigDescription
from labrig.errors import CameraError, InputError
from labrig.steering.tip_search import TipView
from labrig.vision.calibration_file import load_intrinsics, load_plane
from labrig.vision.mask import Mask, load_mask
from labrig.vision.picture import Picture
from labrig.vision.plane import PlaneMap
from labrig.vision.template_file import load_template

_DARKEST_GREY = 12.0


def load_tip_view(rig: RigDescription) -> TipView:
    """Return plane, template and mask of a rig from its calibration files.

    Raises
    ------
    InputError
        When one is missing; `find_problems` reports that before a run.
    """
    plane = load_plane_map(rig)
    files = rig.template_paths()
    if not files:
        raise InputError(
            "the rig file names no template of the tip",
            "labrig calibrate template makes one; see calibration:",
        )
    template = load_template(files["template.png"]).relative_to(plane.insertion)
    return TipView(plane, template, load_rig_mask(rig))


def load_rig_mask(rig: RigDescription) -> Mask | None:
    """Return the mask of a rig; None if its file names none. Raises `InputError` when it cannot be read."""
    masks = [load_mask(path) for path in rig.mask_paths().values()]
    return masks[0] if masks else None


def load_plane_map(rig: RigDescription) -> PlaneMap:
    """Return the plane map of a rig from its calibration files.

    Raises
    ------
    InputError
        When the rig has none, or it cannot be read.
    """
    paths = rig.calibration_paths()
    if "plane.json" not in paths:
        raise InputError("the rig file names no plane", "labrig run protocols/calibration.yaml finds it")
    lens = paths.get("intrinsics.json")
    return load_plane(paths["plane.json"], None if lens is None else load_intrinsics(lens))


def require_light(image: Picture) -> None:
    """Refuse a picture that is too dark to show anything.

    Raises
    ------
    CameraError
        For a dark picture, with its mean and the limit.
    """
    mean = float(image.mean())
    if mean < _DARKEST_GREY:
        raise CameraError(
            f"the picture is dark: its mean is {mean:.1f} of 255, and {_DARKEST_GREY:g} is the least",
            "check the light and the lens cap; then take the needle out with labrig devices withdraw",
        )
