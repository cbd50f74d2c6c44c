"""All paths of alternating arcs in a plane: a tree of first arcs, closed by the last two in closed form.

In the steering plane the point (y, z) is the complex number z + i y, and a heading phi is the unit number
exp(i phi). An arc of sign s (+1 bends towards +y) that starts at p with heading phi turns about
p + i s r exp(i phi); the next arc, of sign -s, about a centre 2 r from that one. So the last arc's centre is
where the circle of radius 2 r about the last-but-one arc's centre meets the circle of radius r about the target:
two places at most. Only the first n - 2 arcs remain to be enumerated, each up to the first obstacle.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labrig.needle.kinematics import FloatArray
from labrig.steering.problem import Surroundings
from labrig.steering.score import ROUNDING

ComplexArray = NDArray[np.complex128]
BoolArray = NDArray[np.bool_]
Keys = NDArray[np.uint64]
"""Numbers of paths, each by its own angles alone: it stays the same whichever others are found."""

# Successive multiples of 2^64 divided by the golden ratio are spread evenly (Knuth, TAOCP 3, 6.4).
_SPREADING = np.uint64(0x9E3779B97F4A7C15)


@dataclass(frozen=True)
class Field:
    """The steering plane with the discs that a path has to avoid, and the limits of a path.

    An obstacle is a disc if its sphere, enlarged by the distance to keep, cuts the plane.
    """

    radius_mm: float
    discs: ComplexArray
    disc_radii_mm: FloatArray
    max_length_mm: float

    @classmethod
    def from_surroundings(cls, around: Surroundings) -> "Field":
        """Return the field of a problem."""
        problem, centres = around.problem, around.centres_mm
        left = around.keep_off_mm**2 - centres[:, 0] ** 2
        cut = left > 0
        discs, radii_mm = centres[cut, 2] + 1j * centres[cut, 1], np.sqrt(left[cut])
        return cls(problem.radius_mm, discs, radii_mm, problem.max_length_mm)

    def with_smaller_discs(self, by_mm: float) -> "Field":
        """Return the same plane with discs smaller by this length; those that vanish stay as points."""
        return replace(self, disc_radii_mm=np.maximum(self.disc_radii_mm - by_mm, 0.0))


def target_in_plane(around: Surroundings) -> complex:
    """Return the target as a point of the plane."""
    return complex(around.target_mm[2], around.target_mm[1])


@dataclass(frozen=True)
class Tips:
    """Ends of N partial paths, the arcs that lead there, and the sign of the next arc.

    Parameters
    ----------
    places : (N,) complex array
    headings_rad : (N,) array
    signs : (N,) array
        Of the next arc.
    angles_rad : (N, k) array
        Of the k arcs so far.
    keys : (N,) array
    """

    places: ComplexArray
    headings_rad: FloatArray
    signs: FloatArray
    angles_rad: FloatArray
    keys: Keys

    def take(self, which: NDArray[np.intp] | BoolArray) -> "Tips":
        """Return a selection of the tips."""
        return Tips(
            self.places[which],
            self.headings_rad[which],
            self.signs[which],
            self.angles_rad[which],
            self.keys[which],
        )


def pick_evenly(keys: Keys, most: int) -> NDArray[np.intp]:
    """Return the indexes of an even selection, in their order.

    Whether one is picked hardly depends on the others: a path that rounding lets touch an obstacle changes one place.
    """
    if len(keys) <= most:
        return np.arange(len(keys))
    return np.sort(np.argpartition(keys * _SPREADING, most)[:most])


def start_tree() -> Tips:
    """Return the start twice, once for each sign of the first arc."""
    return Tips(
        np.zeros(2, complex),
        np.zeros(2),
        np.array([1.0, -1.0]),
        np.zeros((2, 0)),
        np.arange(2, dtype=np.uint64),
    )


def make_psi(angles_rad: FloatArray, first_signs: FloatArray) -> FloatArray:
    """Return paths (N, n, 2): delta_1 is pi for a first arc towards +y and 0 otherwise, every later roll is pi."""
    psi = np.full((*angles_rad.shape, 2), np.pi)
    psi[..., 0] = angles_rad
    psi[:, 0, 1] = np.where(first_signs > 0, np.pi, 0.0)
    return psi


def first_signs(tips: Tips) -> FloatArray:
    """Return the sign of the first arc; signs alternate."""
    return np.asarray(tips.signs * (-1.0) ** tips.angles_rad.shape[1])


def free_angles(tips: Tips, field: Field) -> FloatArray:
    """Return the angle (N,) at which the next arc of each tip meets an obstacle, or the cap on heading or length.

    Half the angle that a disc of radius R cuts off a circle of radius r at distance d is
    acos((r^2 + d^2 - R^2) / (2 r d)).
    """
    radius_mm = field.radius_mm
    to_cap = np.pi / 2 - tips.signs * tips.headings_rad
    free = np.minimum(to_cap, (field.max_length_mm / radius_mm) - tips.angles_rad.sum(axis=1))
    outwards = -1j * tips.signs * np.exp(1j * tips.headings_rad)
    seen = (field.discs - (tips.places - radius_mm * outwards)[:, None]) * outwards.conj()[:, None]
    apart = np.abs(seen)
    tip, disc = np.nonzero(np.abs(apart - radius_mm) < field.disc_radii_mm)
    if tip.size:
        far = apart[tip, disc]
        cosine = (radius_mm**2 + far**2 - field.disc_radii_mm[disc] ** 2) / (2 * radius_mm * far)
        ahead = np.angle(seen[tip, disc]) * tips.signs[tip]
        # The last of the angles before led up to a disc: rounding may not put that place behind the tip.
        until = np.mod(ahead - np.arccos(np.clip(cosine, -1, 1)) + ROUNDING, 2 * np.pi) - ROUNDING
        np.minimum.at(free, tip, until)
    return np.asarray(free)


def grow_tips(tips: Tips, field: Field, samples: int) -> Tips:
    """Return the tips after one more arc, with `samples` angles each up to the end of the free arc."""
    angles = free_angles(tips, field)[:, None] * (np.arange(1, samples + 1) / samples)
    parent, sample = np.nonzero(angles > ROUNDING)
    theta = angles[parent, sample]
    before = tips.take(parent)
    headings = before.headings_rad + before.signs * theta
    chord = np.exp(1j * headings) - np.exp(1j * before.headings_rad)
    places = before.places - 1j * before.signs * field.radius_mm * chord
    grown = np.concatenate((before.angles_rad, theta[:, None]), axis=1)
    keys = before.keys * np.uint64(samples) + sample.astype(np.uint64)
    return Tips(places, headings, -before.signs, grown, keys)


def thin_tips(tips: Tips, cell_mm: float, cell_rad: float, limit: int) -> Tips:
    """Return one tip of each cell of place, heading and sign, evenly thinned to the limit."""
    keys = np.stack(
        (
            np.round(tips.places.real / cell_mm),
            np.round(tips.places.imag / cell_mm),
            np.round(tips.headings_rad / cell_rad),
            tips.signs,
        )
    ).astype(np.int64)
    packed = ((keys[0] * 4096 + keys[1]) * 4096 + keys[2]) * 4 + keys[3]
    _, kept = np.unique(packed, return_index=True)
    return tips.take(kept[pick_evenly(tips.keys[kept], limit)])


@dataclass(frozen=True)
class Closures:
    """Candidate last pairs of arcs, angles (k, 2) from tip `parent[k]`, not yet checked for collisions."""

    parent: NDArray[np.intp]
    angles_rad: FloatArray
    centres: ComplexArray
    joints: ComplexArray
    keys: Keys


def close_paths(tips: Tips, field: Field, target: complex) -> Closures:
    """Return every pair of arcs that leads from a tip to the target within the limits on heading and length.

    With e the unit number from the first centre to the second, the heading at the joint is i s e; the heading at
    the target is -i s (g - c_2) / r. Both have to point forwards, and neither arc may turn back.
    """
    r = field.radius_mm
    start = np.exp(1j * tips.headings_rad)
    first = tips.places + 1j * r * tips.signs * start
    to_target = target - first
    apart = np.abs(to_target)
    cosine = (3 * r * r + apart**2) / (4 * r * np.maximum(apart, 1e-12))
    meets = np.flatnonzero(cosine <= 1.0)
    sine = np.sqrt(1 - cosine[meets] ** 2)
    bases = to_target[meets] / apart[meets]
    e = np.concatenate((bases * (cosine[meets] + 1j * sine), bases * (cosine[meets] - 1j * sine)))
    parent = np.concatenate((meets, meets))
    joint = 1j * tips.signs[parent] * e
    forwards = np.flatnonzero(joint.real >= -1e-12)
    e, joint, parent = e[forwards], joint[forwards], parent[forwards]
    sign, second = tips.signs[parent], first[parent] + 2 * r * e
    end = -1j * sign * (target - second) / r
    turn_1 = joint * start[parent].conj()
    turn_2 = end * joint.conj()
    fits = np.flatnonzero((end.real >= -1e-12) & (turn_1.imag * sign >= 0) & (turn_2.imag * sign <= 0))
    sign = sign[fits]
    angles = np.stack((sign * np.angle(turn_1[fits]), -sign * np.angle(turn_2[fits])), axis=1)
    whole = tips.angles_rad[parent[fits]].sum(axis=1) + angles.sum(axis=1)
    short = np.flatnonzero((whole * r <= field.max_length_mm) & np.all(angles >= 0, axis=1))
    chosen = fits[short]
    centres = np.stack((first[parent[chosen]], second[chosen]), axis=1)
    keys = tips.keys[parent[chosen]] * np.uint64(2) + (forwards[chosen] >= len(meets)).astype(np.uint64)
    return Closures(parent[chosen], angles[short], centres, first[parent[chosen]] + r * e[chosen], keys)


def join_paths(tips: Tips, closures: Closures, which: NDArray[np.intp]) -> FloatArray:
    """Return paths (M, n, 2) of these closures."""
    parents = tips.take(closures.parent[which])
    angles = np.concatenate((parents.angles_rad, closures.angles_rad[which]), axis=1)
    return make_psi(angles, first_signs(parents))


def find_hits(closures: Closures, tips: Tips, field: Field, target: complex) -> BoolArray:
    """Return which last pairs of arcs cut which discs, (k, K), at an end or between the ends.

    A disc cuts an arc between its ends if the disc's centre is within R of the circle and within the arc's sector.
    The sectors are narrower than half a turn, so two signs decide.
    """
    sign = tips.signs[closures.parent]
    ends = np.full_like(closures.joints, target)
    touched = np.abs(closures.joints[:, None] - field.discs) < field.disc_radii_mm
    touched |= np.abs(target - field.discs) < field.disc_radii_mm
    touched |= _find_middle_hits(
        closures.centres[:, 0], tips.places[closures.parent], closures.joints, sign, field
    )
    return np.asarray(
        touched | _find_middle_hits(closures.centres[:, 1], closures.joints, ends, -sign, field)
    )


def _find_middle_hits(
    centres: ComplexArray, starts: ComplexArray, ends: ComplexArray, signs: FloatArray, field: Field
) -> BoolArray:
    seen = field.discs - centres[:, None]
    ring = np.abs(np.abs(seen) - field.radius_mm) < field.disc_radii_mm
    after = (((starts - centres) * signs).conj()[:, None] * seen).imag >= 0
    return np.asarray(ring & after & ((((ends - centres) * signs).conj()[:, None] * seen).imag <= 0))
