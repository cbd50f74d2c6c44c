"""What lies between the camera and the needle: the gel, walls and air gaps, and the correction of their refraction.

All surfaces are flat, and parallel to one another and to the needle's plane, with air between them and the camera. Then
only the camera's place above the plane matters: refraction changes nothing but the distance from the camera's foot at
which a ray reaches the plane.

Each quantity may have a standard deviation. One that has none is in no interval, and is named as such.
"""

from collections.abc import Iterator
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

PaperPlace = Literal["needle", "surface"]
Material = Literal["glass", "acrylic", "polycarbonate", "air"]
FloatArray = NDArray[np.float64]

# Refractive index at 589 nm and its standard deviation between makers and over visible light: soda-lime glass (Schott
# B 270: 1.523; Rubin 1985: 1.52), acrylic (Beadie et al. 2015, Appl. Opt. 54:F139: 1.491), polycarbonate (Sultanova et
# al. 2009, Acta Phys. Pol. A 116:585: 1.585).
MATERIALS: dict[Material, tuple[float, float]] = {
    "glass": (1.52, 0.005),
    "acrylic": (1.49, 0.003),
    "polycarbonate": (1.585, 0.005),
    "air": (1.0, 0.0),
}
_LARGEST_INDEX = 2.0
_MAX_NEWTON_STEPS = 30
_TOLERANCE_MM = 1e-10

_Index = Annotated[float, Field(ge=1, le=_LARGEST_INDEX)]
_IndexSigma = Annotated[float, Field(ge=0, le=0.5)]
_Length = Annotated[float, Field(ge=0, le=1000)]
_LengthSigma = Annotated[float, Field(ge=0, le=100)]


class _Section(BaseModel):
    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


class Layer(_Section):
    """A wall or an air gap between the camera and the gel."""

    index: _Index | Material
    """Refractive index, or the material: glass, acrylic, polycarbonate, air."""
    thickness_mm: _Length
    """Thickness [mm]."""
    thickness_sigma_mm: _LengthSigma | None = None
    """Standard deviation of the thickness [mm]; null: not in the interval."""
    index_sigma: _IndexSigma | None = None
    """Standard deviation of the index; null: that of the material, or not in the interval."""

    @property
    def refractive_index(self) -> float:
        """The index, of the material if that is stated."""
        return MATERIALS[self.index][0] if isinstance(self.index, str) else self.index

    @property
    def sigma(self) -> float | None:
        """The standard deviation of the index; None if it is not known."""
        known = MATERIALS[self.index][1] if isinstance(self.index, str) else None
        return known if self.index_sigma is None else self.index_sigma


class Gel(_Section):
    """The gel between the camera and the needle, and the layers between the camera and the gel.

    Gelatin has a refractive index of about 1.34 to 1.36 at 5 to 15 %: that of water, 1.333, and 0.0018 for each percent
    (proteins have 0.18 to 0.19 mL/g at 578 nm, Perlmann and Longsworth 1948, JACS 70:2719).
    """

    index: _Index
    """Refractive index of the gel; gelatin has about 1.35."""
    depth_mm: _Length
    """Depth of the needle below the gel's flat surface [mm]."""
    paper_at: PaperPlace = "needle"
    """Where the paper lies when it is photographed: in air where the needle is to be, or in air on the
    outermost surface."""
    index_sigma: _IndexSigma | None = None
    """Standard deviation of the index; null: not in the interval."""
    depth_sigma_mm: _LengthSigma | None = None
    """Standard deviation of the depth [mm]; null: not in the interval."""
    layers: tuple[Layer, ...] = ()
    """Walls and air gaps, from the camera to the gel."""

    def assumptions(self) -> tuple[str, ...]:
        """Return the assumptions of the correction, a sentence each."""
        outermost = "outermost" if self.layers else "gel's"
        place = (
            f"where the needle was to be, {self.depth_mm:.4g} mm below the place of the gel's surface"
            if self.paper_at == "needle"
            else f"on the {outermost} surface, {self.height_mm():.4g} mm above the needle"
        )
        between = ", ".join(
            f"{layer.thickness_mm:g} mm of index {layer.refractive_index:g}" for layer in self.layers
        )
        above = (
            f"between air and gel lie, parallel to it, {between}"
            if between
            else "nothing but air lies above it"
        )
        return (
            f"The graph paper lay in air {place}.",
            f"The gel's surface is flat and parallel to the paper, and {above}.",
            f"The gel's refractive index is {self.index:.4g} throughout.",
        )

    def unknown_sigmas(self) -> tuple[str, ...]:
        """Return the quantities without a standard deviation: their errors are in no interval."""
        named = [("the gel's refractive index", self.index_sigma), ("the gel's depth", self.depth_sigma_mm)]
        for number, layer in enumerate(self.layers, start=1):
            named += [
                (f"the refractive index of layer {number}", layer.sigma),
                (f"the thickness of layer {number}", layer.thickness_sigma_mm),
            ]
        return (*(name for name, sigma in named if sigma is None), "the tilt of the gel's surface")

    def vary(self) -> Iterator["Gel"]:
        """Return the gel moved by one standard deviation of each quantity that has one."""
        if self.index_sigma:
            yield self._with(index=_move(self.index, self.index_sigma))
        if self.depth_sigma_mm:
            yield self._with(depth_mm=self.depth_mm + self.depth_sigma_mm)
        for number, layer in enumerate(self.layers):
            moved = []
            if layer.sigma:
                moved.append({"index": _move(layer.refractive_index, layer.sigma)})
            if layer.thickness_sigma_mm:
                moved.append({"thickness_mm": layer.thickness_mm + layer.thickness_sigma_mm})
            for change in moved:
                other = layer.model_copy(update=change)
                yield self._with(layers=(*self.layers[:number], other, *self.layers[number + 1 :]))

    def _with(self, **change: object) -> "Gel":
        return self.model_copy(update=change)

    def height_mm(self) -> float:
        """Return how far the outermost surface lies above the needle."""
        return self.depth_mm + sum(layer.thickness_mm for layer in self.layers)

    def bend(self, straight_mm: FloatArray, camera_mm: FloatArray) -> FloatArray:
        """Return where rays reach the needle's plane (N, 2) [mm] that would reach the paper's plane at `straight_mm`.

        `camera_mm` (3,) is the camera's foot on the paper's plane and its height above it.
        """
        aside = straight_mm - camera_mm[:2]
        return np.asarray(camera_mm[:2] + aside * self._stretch(np.hypot(*aside.T), camera_mm[2])[:, None])

    def straighten(self, bent_mm: FloatArray, camera_mm: FloatArray) -> FloatArray:
        """Return where the rays would reach the paper's plane (N, 2) [mm] without refraction: the inverse of `bend`."""
        aside = bent_mm - camera_mm[:2]
        wanted = np.hypot(*aside.T)
        found = wanted.copy()
        for _ in range(_MAX_NEWTON_STEPS):
            missing = wanted - found * self._stretch(found, camera_mm[2])
            # The stretch hardly changes with the distance, so dividing by it is nearly Newton's step.
            found = found + missing / self._stretch(found, camera_mm[2])
            if np.abs(missing).max(initial=0.0) <= _TOLERANCE_MM:
                break
        return np.asarray(camera_mm[:2] + aside * (found / np.maximum(wanted, np.finfo(float).tiny))[:, None])

    def _stretch(self, distance_mm: FloatArray, height_mm: float) -> FloatArray:
        """Return the factors (N,) by which refraction stretches distances from the camera's foot."""
        slope = distance_mm / height_mm
        straight = 0.0 if self.paper_at == "surface" else 1.0
        media = [(layer.refractive_index, layer.thickness_mm) for layer in self.layers]
        stretch: FloatArray = np.ones_like(slope)
        for index, thickness_mm in (*media, (self.index, self.depth_mm)):
            # sin b = sin a / n, written with tangents.
            inner = 1.0 / np.sqrt(index**2 * (1.0 + slope**2) - slope**2)
            stretch = stretch + thickness_mm / height_mm * (inner - straight)
        return stretch


def _move(value: float, sigma: float) -> float:
    """Return an index moved up by its standard deviation, or down if it would exceed its limit."""
    return value + sigma if value + sigma <= _LARGEST_INDEX else value - sigma
