"""Trapezoidal velocity profiles as a closed form of time."""

import math
from dataclasses import dataclass
from itertools import accumulate


@dataclass(frozen=True)
class Segment:
    """A stretch of constant acceleration: from position and velocity at `start_s`, for `duration_s`."""

    start_s: float
    duration_s: float
    position: float
    velocity: float
    acceleration: float

    def after(self, t_s: float) -> tuple[float, float]:
        """Return (position, velocity) a time after its start, which is held within the segment."""
        t_s = min(max(t_s, 0.0), self.duration_s)
        return (
            self.position + self.velocity * t_s + 0.5 * self.acceleration * t_s * t_s,
            self.velocity + self.acceleration * t_s,
        )

    @property
    def end(self) -> tuple[float, float]:
        """Return (position, velocity) at its end.

        Not by the time at its end: late on the clock a short ramp loses its last digits in that sum, and a long cruise
        at the velocity that is left would end far from where it should.
        """
        return self.after(self.duration_s)


@dataclass(frozen=True)
class Profile:
    """A motion that comes to rest at `end_position` at `end_s`."""

    segments: tuple[Segment, ...]
    end_s: float
    end_position: float

    def range_within(self, from_s: float, until_s: float) -> tuple[float, float]:
        """Return the lowest and the highest position between two times: a profile turns only where segments meet."""
        turns = (segment.start_s for segment in self.segments if from_s < segment.start_s < until_s)
        positions = [self.at(t_s)[0] for t_s in (from_s, *turns, until_s)]
        return min(positions), max(positions)

    def at(self, t_s: float) -> tuple[float, float]:
        """Return (position, velocity) at a time; at rest exactly at the end position from the end on."""
        if t_s >= self.end_s:
            return self.end_position, 0.0
        for segment in self.segments:
            if t_s < segment.start_s + segment.duration_s:
                return segment.after(t_s - segment.start_s)
        return self.end_position, 0.0


def make_rest_profile(t_s: float, position: float) -> Profile:
    """Return the profile that stands still."""
    return Profile((), t_s, position)


def make_brake_profile(t_s: float, position: float, velocity: float, deceleration: float) -> Profile:
    """Return the profile that comes to rest as soon as the deceleration allows."""
    duration = abs(velocity) / deceleration
    return _join_phases(t_s, position, velocity, [(duration, -math.copysign(deceleration, velocity))], None)


@dataclass(frozen=True)
class Limits:
    """Positive limits of a motion, in the unit of position and s."""

    speed: float
    acceleration: float
    deceleration: float


def make_move_profile(t_s: float, position: float, velocity: float, target: float, limits: Limits) -> Profile:
    """Return the fastest profile to a target within limits.

    Parameters
    ----------
    t_s, position, velocity : float
        Where the motion starts; a velocity away from the target, or too high to stop at it, is braked first.
    target : float
        Where it ends, at rest.
    limits : Limits
        Of speed and of both accelerations.
    """
    away = target - position
    stopping = velocity * abs(velocity) / (2 * limits.deceleration)
    if velocity * away < 0 or abs(stopping) > abs(away):
        first = make_brake_profile(t_s, position, velocity, limits.deceleration)
        rest = make_move_profile(first.end_s, first.end_position, 0.0, target, limits)
        return Profile(first.segments + rest.segments, rest.end_s, rest.end_position)
    direction = math.copysign(1.0, away)
    phases = _plan_phases(abs(away), abs(velocity), limits)
    return _join_phases(
        t_s, position, velocity, [(duration, direction * a) for duration, a in phases], target
    )


def _plan_phases(distance: float, velocity: float, limits: Limits) -> list[tuple[float, float]]:
    """Return (duration, acceleration) of speeding up (or down to the limit), cruising and braking."""
    up, down = limits.acceleration, limits.deceleration
    peak = min(limits.speed, math.sqrt((2 * up * down * distance + down * velocity**2) / (up + down)))
    rate = up if peak >= velocity else -down
    cruise = distance - (peak**2 - velocity**2) / (2 * rate) - peak**2 / (2 * down)
    cruise_s = max(0.0, cruise) / peak if peak > 0 else 0.0
    return [((peak - velocity) / rate, rate), (cruise_s, 0.0), (peak / down, -down)]


def _join_phases(
    t_s: float, position: float, velocity: float, phases: list[tuple[float, float]], target: float | None
) -> Profile:
    """Join phases into a profile; `target` replaces the end, which rounding leaves a hair beside it."""
    segments = []
    starts = accumulate((duration for duration, _ in phases), initial=t_s)
    for start_s, (duration, acceleration) in zip(starts, phases, strict=False):
        segments.append(Segment(start_s, duration, position, velocity, acceleration))
        position, velocity = segments[-1].end
    end_s = segments[-1].start_s + segments[-1].duration_s
    return Profile(tuple(segments), end_s, position if target is None else target)
