"""What the options of `labrig calibrate plane` say of gel and walls, as values."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast, get_args

from labrig.errors import InputError
from labrig.vision.gel_measurement import SeenThrough
from labrig.vision.picture import read_picture
from labrig.vision.refraction import Gel, Layer, Material, PaperPlace

# Where the search begins if the picture through the gel is to give the depth, or the index.
_FIRST_DEPTH_MM, _FIRST_INDEX = 10.0, 1.35


@dataclass(frozen=True)
class SurfaceOptions:
    """What was typed of the gel and of the layers above it; None where an option was left out."""

    index: float | None = None
    depth_mm: float | None = None
    paper_at: PaperPlace = "needle"
    index_sigma: float | None = None
    depth_sigma_mm: float | None = None
    layers: Sequence[str] | None = None
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    tilt_sigma_deg: float | None = None
    through: Path | None = None

    def make_gel(self, *, camera_known: bool) -> Gel | None:
        """Return the gel above the needle, None if no option describes it.

        Parameters
        ----------
        camera_known : bool
            Intrinsics are given, or the lens is telecentric.

        Raises
        ------
        InputError
            If index or depth is missing, one of the options is impossible, or the camera is not calibrated.
        """
        self._require_both()
        if self.index is None and self.depth_mm is None:
            return None
        if not camera_known:
            raise InputError(
                "a gel's refraction needs the camera's intrinsics",
                "calibrate them first and give --intrinsics FILE",
            )
        return Gel(
            _FIRST_INDEX if self.index is None else self.index,
            _FIRST_DEPTH_MM if self.depth_mm is None else self.depth_mm,
            self.paper_at,
            self.index_sigma,
            self.depth_sigma_mm,
            tuple(map(read_layer, self.layers or ())),
            (math.radians(self.tilt_deg[0]), math.radians(self.tilt_deg[1])),
            None if self.tilt_sigma_deg is None else math.radians(self.tilt_sigma_deg),
        )

    def read_seen_through(self) -> SeenThrough | None:
        """Return the picture through the gel, and what it is to give; None without one. Raises `PictureError`."""
        if self.through is None:
            return None
        return SeenThrough(read_picture(self.through), "depth" if self.depth_mm is None else "index")

    def _require_both(self) -> None:
        """Refuse index without depth; with a picture through the gel, both or none of them."""
        given = (self.index is not None) + (self.depth_mm is not None)
        if self.through is not None:
            measured = (
                ("depth", self.depth_sigma_mm) if self.depth_mm is None else ("index", self.index_sigma)
            )
            if given != 1 or measured[1] is not None or any(self.tilt_deg) or self.tilt_sigma_deg is not None:
                raise InputError(
                    "--through-gel measures the tilt and either depth or index, so one of these two has to be given",
                    "for example --gel-index 1.35 --gel-index-sigma 0.01, without depth and tilt",
                )
        elif given == 1:
            raise InputError(
                "--gel-index and --gel-depth-mm belong together",
                "for example --gel-index 1.35 --gel-depth-mm 10",
            )
        elif not given and self.paper_at != "needle":
            raise InputError(
                f"--paper-at {self.paper_at} belongs to a gel, and none is described",
                "give --gel-index and --gel-depth-mm too",
            )
        elif not given and self._describes_more():
            raise InputError(
                "layers, tilts and standard deviations belong to a gel",
                "give --gel-index and --gel-depth-mm too; --gel-index 1 for a needle in air",
            )

    def _describes_more(self) -> bool:
        sigmas = (self.index_sigma, self.depth_sigma_mm, self.tilt_sigma_deg)
        return bool(self.layers) or any(self.tilt_deg) or any(sigma is not None for sigma in sigmas)


def read_layer(text: str) -> Layer:
    """Read `glass:3:0.1` as a layer of glass, 3 mm thick with a standard deviation of 0.1 mm.

    Raises
    ------
    InputError
        If the text is none, or the layer is impossible.
    """
    material, *numbers = text.split(":")
    try:
        values = [float(number) for number in numbers]
        known = material if material in get_args(Material) else float(material)
    except ValueError:
        values = []
    if not 1 <= len(values) <= 2 or not all(map(math.isfinite, values)):
        raise InputError(
            f"--layer is {text[:40]!r}, and has to name a material, its thickness and perhaps its deviation in mm",
            f"for example --layer glass:3:0.1; materials are {', '.join(get_args(Material))}, or an index",
        )
    return Layer.of(cast("Material | float", known), *values)
