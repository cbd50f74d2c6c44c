"""Values of the tip filters: settings, observation and estimated state."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtri

from labrig.errors import InputError
from labrig.needle.kinematics import FloatArray
from labrig.protocol.model import PositiveMm
from labrig.steering.parameters import Estimator

# The errors of a tip: position and rotation vector, both in the tip's own frame, curvature and, if estimated, slip.
POSITION, ORIENTATION, CURVATURE, SLIP = slice(0, 3), slice(3, 6), 6, 7
# Shares of good observations that pass the gate of the error-state filter, and the gate after a rejected one.
_GATE_PROBABILITY, _DOUBTFUL_PROBABILITY = 0.9999, 0.95
# In the plane the tip moves along its y and z axes and turns about its x axis.
_PLANAR_ERRORS, _SPATIAL_ERRORS = (1, 2, 3), (0, 1, 2, 3, 4, 5)
_ROTATION_TOLERANCE = 1.1e-5  # of rows that are written with five digits


class EstimatorSettings(Estimator):
    """How the tip of a needle of a radius is estimated.

    Where the needle is `planar` it stays in the y-z plane of its start: disturbances and observations out of it are
    ignored, as in section V-C of the paper. Rolls are then whole half turns.
    """

    radius_mm: PositiveMm
    planar: bool = False

    @cached_property
    def size(self) -> int:
        """The number of errors of a tip here."""
        return SLIP + 1 if self.estimates_slip else SLIP

    @property
    def estimates_slip(self) -> bool:
        """Whether the slip is uncertain."""
        return self.slip_sd > 0.0 and self.method != "paper"

    @cached_property
    def errors(self) -> tuple[int, ...]:
        """Which of the errors of a tip are uncertain here: the degrees of freedom of its NEES."""
        pose = _PLANAR_ERRORS if self.planar else _SPATIAL_ERRORS
        pose = (*pose, CURVATURE) if self.radius_sd_mm > 0.0 else pose
        return (*pose, SLIP) if self.estimates_slip else pose

    @cached_property
    def observed(self) -> FloatArray:
        """H, (2 or 3, size): the errors that an observation sees, in the tip's frame; in the plane x is not seen."""
        return freeze(np.eye(self.size)[1:3] if self.planar else np.eye(self.size)[:3])

    @property
    def noise(self) -> FloatArray:
        """R, the covariance of an observation [mm^2]; not kept, as `model_copy` would keep it beside another value."""
        return self.observation_sd_mm**2 * self.observed[:, self.seen]

    @cached_property
    def turning(self) -> FloatArray:
        """The errors of orientation that are uncertain, as ones on a diagonal (size, size)."""
        turning = np.zeros(self.size)
        turning[3 : 4 if self.planar else 6] = 1.0
        return freeze(np.diag(turning))

    @cached_property
    def seen(self) -> slice:
        """The errors that an observation sees, as places in a vector of errors."""
        return slice(1, 3) if self.planar else slice(0, 3)

    @cached_property
    def gate_nis(self) -> float:
        """The NIS beyond which an observation is rejected, from the chi-square distribution."""
        return float(chdtri(len(self.observed), 1.0 - _GATE_PROBABILITY))

    @cached_property
    def doubtful_nis(self) -> float:
        """The NIS beyond which an observation after a rejected one is rejected too."""
        return float(chdtri(len(self.observed), 1.0 - _DOUBTFUL_PROBABILITY))


@dataclass(frozen=True, eq=False)
class TipObservation:
    """One observation: the roll applied, then the length inserted, then the position seen.

    Parameters
    ----------
    position_mm : (3,) array or None
        None if the tip was not found.
    step_mm : float
        Inserted since the previous observation, 0 or more.
    roll_rad : float
        Roll before that, about the needle's axis; in the plane it is a whole number of half turns.
    bends : bool
        Whether the tip bends over the step; False while its hinges have not closed yet and it goes straight.
    """

    position_mm: FloatArray | None
    step_mm: float
    roll_rad: float = 0.0
    bends: bool = True


@dataclass(frozen=True, eq=False)
class TipState:
    """The tip as estimated.

    Attributes
    ----------
    rotation : (3, 3) array
        Its orientation; read-only.
    position_mm : (3,) array
        Read-only.
    curvature : float
        Of the path [1/mm].
    covariance : (7, 7) or (8, 8) array
        Of the errors of position [mm] and orientation (rotation vector, [rad]), both in the tip's own frame, of
        curvature [1/mm] and, if it is estimated, of slip [-]; zero for what counts as known. Read-only.
    nis : float or None
        Normalised innovation squared of the last observation; None without an observation.
    accepted : bool
        Whether the last observation was used.
    misses : int
        Observations in a row that were missing or rejected.
    log_likelihood : float
        Of the last observation given the prediction; 0 without an observation.
    slip : float
        Share of the inserted length by which the tip stays behind [-].
    """

    rotation: FloatArray
    position_mm: FloatArray
    curvature: float
    covariance: FloatArray
    nis: float | None
    accepted: bool
    misses: int
    log_likelihood: float = 0.0
    slip: float = 0.0

    @property
    def pose(self) -> FloatArray:
        """T_w_t, (4, 4), in mm; read-only."""
        return make_pose(self.rotation, self.position_mm)

    @property
    def heading_rad(self) -> float:
        """Angle of the tangent in the y-z plane, zero along z and positive towards +y."""
        return math.atan2(self.rotation[1, 2], self.rotation[2, 2])

    @property
    def position_sd_mm(self) -> float:
        """Standard deviation of the position along its least certain axis."""
        return math.sqrt(float(np.linalg.eigvalsh(self.covariance[POSITION, POSITION])[-1]))

    @property
    def heading_sd_rad(self) -> float:
        """Standard deviation of the tangent's direction about the less certain of the tip's x and y axes."""
        (about_x, common), (_, about_y) = self.covariance[3:5, 3:5].tolist()
        return math.sqrt(0.5 * (about_x + about_y) + math.hypot(0.5 * (about_x - about_y), common))


def require_numbers(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> FloatArray:
    """Return an array of finite numbers of this shape, in which None stands for any length.

    Raises
    ------
    InputError
        With the name, and the shape or the first wrong place.
    """
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} is not an array of numbers: {error}") from error
    if array.ndim != len(shape) or any(s not in {None, n} for s, n in zip(shape, array.shape, strict=True)):
        wanted = ", ".join("N" if s is None else str(s) for s in shape)
        raise InputError(f"{name} has shape {array.shape}, expected ({wanted})")
    if not np.isfinite(array).all():
        place = [int(i) for i in np.argwhere(~np.isfinite(array))[0]]
        raise InputError(f"{name}{place} is {array[tuple(place)]}", "leave out what was not measured")
    return array


def require_pose(name: str, value: ArrayLike) -> FloatArray:
    """Return a pose (4, 4).

    Raises
    ------
    InputError
        For another shape, a number that is not finite, or a matrix without a rotation.
    """
    pose = require_numbers(name, value, (4, 4))
    rotation = pose[:3, :3]
    off = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    if off > _ROTATION_TOLERANCE or np.linalg.det(rotation) < 0.0:
        raise InputError(
            f"the upper left 3x3 of {name} is not a rotation: R^T R is off by {off:.2g}, det R is "
            f"{np.linalg.det(rotation):.4g}",
            "its columns are the tip's axes: orthogonal, of length 1, right-handed",
        )
    if not np.array_equal(pose[3], (0.0, 0.0, 0.0, 1.0)):
        raise InputError(f"the last row of {name} is {pose[3].tolist()}, expected [0, 0, 0, 1]")
    return pose


def make_pose(rotation: FloatArray, position: FloatArray) -> FloatArray:
    """Return the pose (4, 4) of a rotation (3, 3) and a position (3,); read-only."""
    pose = np.zeros((4, 4))
    pose[:3, :3], pose[:3, 3], pose[3, 3] = rotation, position, 1.0
    return freeze(pose)


def freeze(array: FloatArray) -> FloatArray:
    """Return the array itself, read-only from now on."""
    array.flags.writeable = False
    return array
