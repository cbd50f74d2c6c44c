"""What lies between the camera and the needle: the gel, walls and air gaps, and the correction of their refraction.

All surfaces are flat and parallel to one another, with air between them and the camera. Where they are also parallel
to the needle's plane, only the camera's place above the plane matters: refraction changes nothing but the distance rho
from the camera's foot at which a ray reaches the plane. Tilted surfaces, and the parallel rays of a telecentric lens,
are traced in three dimensions (`snell`).

Each quantity may have a standard deviation. One that has none is in no interval, and is named as such.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray

from labrig.errors import InputError
from labrig.vision.snell import Stack, trace_rays

PaperPlace = Literal["needle", "surface", "gel"]
Material = Literal["glass", "acrylic", "polycarbonate", "air"]
Quantity = Literal["depth", "index"]
_FloatArray = NDArray[np.float64]

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
_LARGEST_INDEX_SIGMA = 0.5
_LARGEST_MM = 1e4
_LARGEST_TILT_RAD = float(np.deg2rad(20.0))
_LARGEST_TILT_SIGMA_RAD = float(np.deg2rad(10.0))
# How far the corners of a varied tilt lie out along either axis, in standard deviations.
_CORNER = float(np.sqrt(0.5))
_MAX_NEWTON_STEPS = 30
_TOLERANCE_MM = 1e-10


@dataclass(frozen=True)
class Layer:
    """A wall or an air gap between the camera and the gel.

    Attributes
    ----------
    index : float
        Refractive index; `MATERIALS` has those of usual walls.
    thickness_mm : float
    index_sigma, thickness_sigma_mm : float or None
        Standard deviations; None if they are not known.
    """

    index: float
    thickness_mm: float
    index_sigma: float | None = None
    thickness_sigma_mm: float | None = None

    def __post_init__(self) -> None:
        _check_index("a layer's index", self.index, self.index_sigma)
        _check_length(
            "a layer's thickness", self.thickness_mm, self.thickness_sigma_mm, "measure it with a caliper"
        )

    @classmethod
    def of(
        cls,
        material: Material | float,
        thickness_mm: float,
        thickness_sigma_mm: float | None = None,
        index_sigma: float | None = None,
    ) -> Self:
        """Make a layer of a material, which gives index and standard deviation, or of a stated index."""
        index, known = (material, None) if isinstance(material, float | int) else MATERIALS[material]
        sigma = known if index_sigma is None else index_sigma
        return cls(float(index), thickness_mm, sigma, thickness_sigma_mm)


@dataclass(frozen=True)
class Gel:
    """The gel between the camera and the needle, and the layers between the camera and the gel.

    Attributes
    ----------
    index : float
        Refractive index; gelatin has about 1.34 to 1.36 at 5 to 15 %: that of water, 1.333, and 0.0018 for each percent
        (proteins have 0.18 to 0.19 mL/g at 578 nm, Perlmann and Longsworth 1948, JACS 70:2719).
    depth_mm : float
        Depth of the needle below the gel's surface, at the origin.
    paper : "needle", "surface" or "gel"
        Place of the graph paper at the plane calibration: in air, where the needle was to be, or on the outermost
        surface; or in the gel, where the needle was to be, seen through all layers.
    index_sigma, depth_sigma_mm : float or None
        Standard deviations; None if they are not known.
    layers : tuple of Layer
        From the camera to the gel.
    tilt_rad : (float, float)
        By how much the surfaces rise towards the camera along +y and +z of the steering plane.
    tilt_sigma_rad : float or None
        Standard deviation of each of the two.
    """

    index: float
    depth_mm: float
    paper: PaperPlace = "needle"
    index_sigma: float | None = None
    depth_sigma_mm: float | None = None
    layers: tuple[Layer, ...] = ()
    tilt_rad: tuple[float, float] = (0.0, 0.0)
    tilt_sigma_rad: float | None = None

    def __post_init__(self) -> None:
        _check_index("the gel's index", self.index, self.index_sigma)
        _check_length(
            "the gel's depth",
            self.depth_mm,
            self.depth_sigma_mm,
            "measure from the gel's surface to the needle",
        )
        limits = (
            *(("tilt", abs(tilt), _LARGEST_TILT_RAD) for tilt in self.tilt_rad),
            ("tilt's standard deviation", self.tilt_sigma_rad, _LARGEST_TILT_SIGMA_RAD),
        )
        for what, angle, most in limits:
            if angle is not None and not 0.0 <= angle <= most:
                raise InputError(
                    f"the surface's {what} is {np.rad2deg(angle):.3g} degrees, and must be from 0 to "
                    f"{np.rad2deg(most):g}",
                    "level the gel, or turn the camera to face its surface",
                )
        if self.paper not in get_args(PaperPlace):
            raise InputError(
                f"the paper cannot lie at {self.paper!r}", f"one of {', '.join(get_args(PaperPlace))}"
            )

    def assumptions(self) -> tuple[str, ...]:
        """Return the assumptions of the correction, a sentence each."""
        return (
            f"The graph paper lay {self._say_place()}.",
            self._say_surface(),
            f"The gel's refractive index is {self.index:.4g} throughout.",
        )

    def unknown_sigmas(self) -> tuple[str, ...]:
        """Return the quantities without a standard deviation: their errors are in no interval."""
        named = [("the gel's refractive index", self.index_sigma), ("the gel's depth", self.depth_sigma_mm)]
        for number, layer in enumerate(self.layers, start=1):
            named += [
                (f"the refractive index of layer {number}", layer.index_sigma),
                (f"the thickness of layer {number}", layer.thickness_sigma_mm),
            ]
        named.append(("the tilt of the gel's surface", self.tilt_sigma_rad))
        return tuple(name for name, sigma in named if sigma is None)

    def vary(self) -> Iterator["Gel"]:
        """Return the gel moved by one standard deviation of each quantity that has one."""
        if self.index_sigma:
            yield replace(self, index=_move(self.index, self.index_sigma, _LARGEST_INDEX))
        if self.depth_sigma_mm:
            yield replace(self, depth_mm=self.depth_mm + self.depth_sigma_mm)
        for number, layer in enumerate(self.layers):
            moved = []
            if layer.index_sigma:
                moved.append(replace(layer, index=_move(layer.index, layer.index_sigma, _LARGEST_INDEX)))
            if layer.thickness_sigma_mm:
                moved.append(replace(layer, thickness_mm=layer.thickness_mm + layer.thickness_sigma_mm))
            for other in moved:
                yield replace(self, layers=(*self.layers[:number], other, *self.layers[number + 1 :]))
        yield from self._vary_tilt()

    def _vary_tilt(self) -> Iterator["Gel"]:
        """Return the gel tilted to four corners.

        Both tilts together move radii as much as either alone, and their squares do too. The corners count this product
        in full, and an effect in proportion to the tilt sqrt 2 times.
        """
        if self.tilt_sigma_rad:
            step = self.tilt_sigma_rad * _CORNER
            for signs in product((-1.0, 1.0), repeat=2):
                corner = np.clip(
                    self.tilt_rad + step * np.array(signs), -_LARGEST_TILT_RAD, _LARGEST_TILT_RAD
                )
                yield replace(self, tilt_rad=(float(corner[0]), float(corner[1])))

    def height_mm(self) -> float:
        """Return how far the outermost surface lies above the needle at the origin."""
        return self._stack().height_mm()

    def depths_mm(self, points_mm: _FloatArray) -> _FloatArray:
        """Return the gel's depth (N,) over points of the needle's plane (N, 2); negative where they are above it."""
        return np.asarray(self.depth_mm + points_mm @ np.tan(self.tilt_rad))

    def bend(self, straight_mm: _FloatArray, centre: _FloatArray) -> _FloatArray:
        """Return where rays reach the needle's plane (N, 2) [mm] that would reach the paper's plane at `straight_mm`.

        `centre` (4,) is the camera's, in homogeneous coordinates of the paper's plane (x, y, z, w) with x away from the
        camera: (-height, foot, 1), or, for a telecentric lens, a direction towards the camera and 0.
        """
        if self._is_radial(centre):
            aside = straight_mm - centre[1:3]
            return np.asarray(centre[1:3] + aside * self._stretch(_length(aside), -centre[0])[:, None])
        return self._trace(straight_mm, centre, derive=False)[0]

    def straighten(self, bent_mm: _FloatArray, centre: _FloatArray) -> _FloatArray:
        """Return where the rays would reach the paper's plane (N, 2) [mm] without refraction: the inverse of `bend`."""
        if self._is_radial(centre):
            return self._straighten_radially(bent_mm, centre)
        found = bent_mm.copy()
        for _ in range(_MAX_NEWTON_STEPS):
            ends, slopes = self._trace(found, centre, derive=True)
            missing = bent_mm - ends
            found = found + np.linalg.solve(slopes, missing[:, :, None])[:, :, 0]
            if np.abs(missing).max(initial=0.0) <= _TOLERANCE_MM:
                break
        return found

    def _is_radial(self, centre: _FloatArray) -> bool:
        return not any(self.tilt_rad) and bool(centre[3])

    def _straighten_radially(self, bent_mm: _FloatArray, centre: _FloatArray) -> _FloatArray:
        aside = bent_mm - centre[1:3]
        wanted = _length(aside)
        found = wanted.copy()
        for _ in range(_MAX_NEWTON_STEPS):
            missing = wanted - found * self._stretch(found, -centre[0])
            # The stretch hardly changes with the distance, so dividing by it is nearly Newton's step.
            found = found + missing / self._stretch(found, -centre[0])
            if np.abs(missing).max(initial=0.0) <= _TOLERANCE_MM:
                break
        return np.asarray(centre[1:3] + aside * (found / np.maximum(wanted, np.finfo(float).tiny))[:, None])

    def _stretch(self, distance_mm: _FloatArray, height_mm: float) -> _FloatArray:
        """Return the factors (N,) by which refraction stretches distances from the camera's foot."""
        slope = distance_mm / height_mm
        straight = 0.0 if self.paper == "surface" else 1.0
        stretch: _FloatArray = np.zeros_like(slope)
        stack = self._stack()
        for index, thickness_mm in zip(stack.indices, (*stack.thicknesses_mm, stack.depth_mm), strict=True):
            # sin b = sin a / n, written with tangents.
            inner = 1.0 / np.sqrt(index**2 * (1.0 + slope**2) - slope**2)
            stretch = stretch + thickness_mm / height_mm * (inner - straight)
        return np.asarray(1.0 + stretch)

    def _stack(self) -> Stack:
        along_y, along_z = np.tan(self.tilt_rad)
        return Stack(
            (*(layer.index for layer in self.layers), self.index),
            tuple(layer.thickness_mm for layer in self.layers),
            self.depth_mm,
            (float(along_y), float(along_z)),
        )

    def _trace(
        self, straight_mm: _FloatArray, centre: _FloatArray, *, derive: bool
    ) -> tuple[_FloatArray, _FloatArray]:
        """Return the ends (N, 2) of the rays, and their derivatives (N, 2, 2), which are empty unless wanted."""
        stack = self._stack()
        turn, shift = np.eye(3), np.zeros(3)
        if self.paper == "surface":
            turn, shift = _turn_to(stack.normal()), np.array([-stack.height_mm(), 0.0, 0.0])
        points = straight_mm @ turn[:, 1:].T + shift
        camera = np.array([*(turn @ centre[:3] + centre[3] * shift), centre[3]])
        return trace_rays(stack, points, turn[:, 1:] if derive else np.empty((3, 0)), camera)

    def _say_place(self) -> str:
        if self.paper == "needle":
            return f"in air where the needle was to be, {self.depth_mm:.4g} mm below the place of the gel's surface"
        if self.paper == "gel":
            return f"in the gel where the needle was to be, {self.depth_mm:.4g} mm below the gel's surface"
        outermost = "outermost" if self.layers else "gel's"
        return f"in air on the {outermost} surface, {self.height_mm():.4g} mm above the needle"

    def _say_surface(self) -> str:
        along_y, along_z = np.rad2deg(self.tilt_rad)
        tilted = f"rises towards the camera by {along_y:.3g} degrees along +y and {along_z:.3g} along +z"
        lies = tilted if any(self.tilt_rad) else "parallel to the paper"
        if not self.layers:
            return f"The gel's surface is flat and {lies}, and nothing but air lies above it."
        between = ", ".join(f"{layer.thickness_mm:g} mm of index {layer.index:g}" for layer in self.layers)
        return f"The gel's surface is flat and {lies}; between air and gel lie, parallel to it, {between}."


@dataclass(frozen=True)
class GelMeasurement:
    """What paper seen through the gel says about it.

    Attributes
    ----------
    quantity : "depth" or "index"
        What was fitted; the depth in mm.
    value, sigma : float
    tilt_deg : (float, float)
        By how much the surface rises towards the camera along +y and +z.
    tilt_sigma_deg : float
    rms_mm : float
        Distance of the crossings from an even grid, with the gel.
    crossings : int
    """

    quantity: Quantity
    value: float
    sigma: float
    tilt_deg: tuple[float, float]
    tilt_sigma_deg: float
    rms_mm: float
    crossings: int

    def sentence(self) -> str:
        """Return the measurement in words."""
        what = (
            f"{self.value:.2f} ± {self.sigma:.2f} mm deep"
            if self.quantity == "depth"
            else f"of index {self.value:.4f} ± {self.sigma:.4f}"
        )
        along_y, along_z = self.tilt_deg
        return (
            f"By {self.crossings} crossings seen through it the gel is {what}, and its surface rises by {along_y:.2f} "
            f"degrees along +y and {along_z:.2f} along +z, ± {self.tilt_sigma_deg:.2f}; left are {self.rms_mm:.3f} mm "
            "rms."
        )


def _move(value: float, sigma: float, most: float) -> float:
    """Return a value moved up by its standard deviation, or down if it would exceed its limit."""
    return value + sigma if value + sigma <= most else value - sigma


def _check_index(what: str, index: float, sigma: float | None) -> None:
    if not 1.0 <= index <= _LARGEST_INDEX:
        raise InputError(
            f"{what} is {index}, and must be from 1 to {_LARGEST_INDEX:g}",
            "gelatin has about 1.35, acrylic 1.49, glass 1.52",
        )
    if sigma is not None and not 0.0 <= sigma <= _LARGEST_INDEX_SIGMA:
        raise InputError(
            f"the standard deviation of {what} is {sigma}, and must be from 0 to {_LARGEST_INDEX_SIGMA:g}",
            "that of gelatin of unknown strength is about 0.01",
        )


def _check_length(what: str, length_mm: float, sigma_mm: float | None, hint: str) -> None:
    for named, value in ((what, length_mm), (f"the standard deviation of {what}", sigma_mm)):
        if value is not None and not 0.0 <= value <= _LARGEST_MM:
            raise InputError(f"{named} is {value} mm, and must be from 0 to {_LARGEST_MM:g}", hint)


def _turn_to(normal: _FloatArray) -> _FloatArray:
    """Return the rotation (3, 3) that turns the x axis into a unit vector, about the axis perpendicular to both."""
    _, b, c = normal
    share = 1.0 / (1.0 + normal[0])
    return np.array(
        [
            [normal[0], -b, -c],
            [b, 1.0 - share * b * b, -share * b * c],
            [c, -share * b * c, 1.0 - share * c * c],
        ]
    )


def _length(points: _FloatArray) -> _FloatArray:
    return np.asarray(np.hypot(points[:, 0], points[:, 1]))
