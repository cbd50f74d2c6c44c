"""Supervises what the axes carry: stalls while they move, and inputs of the drives beyond their limits."""

import math
from collections.abc import Iterable, Mapping
from contextlib import suppress

from labrig.clock import Clock
from labrig.devices.axis import Axis
from labrig.devices.drive import raise_together
from labrig.devices.input_channel import InputValue
from labrig.devices.position_supervision import TIME_MARGIN_S, InMotion, PositionReading, bound_lag
from labrig.devices.stall import LoadReading, StallBounds, supervise_stall
from labrig.errors import MachineError

_EARLY_S = 1e-6


class LoadGuard:
    """What is remembered of the load of each axis, and when it is looked at.

    Parameters
    ----------
    holds_inputs : bool
        Whether limits of inputs hold.
    """

    def __init__(self, *, holds_inputs: bool) -> None:
        self._holds_inputs = holds_inputs
        self._bounds: dict[str, StallBounds] = {}
        self._looked_s: dict[str, float] = {}
        self._since_s: dict[str, float | None] = {}

    def get_ready(self, axes: Iterable[Axis], limits_ma: Mapping[str, int]) -> None:
        """Read which current limits are in force, and require that no input is beyond its limits.

        Parameters
        ----------
        axes : iterable of Axis
            The axes.
        limits_ma : mapping of str to int
            Axis -> limit that rig file, protocol or command name [mA]; an axis without one has no stall.

        Raises
        ------
        ForceGuardError, DriveError, BusError
        """
        for axis in axes:
            if axis.name not in limits_ma:
                continue
            drive, limit_ma = axis.drive, axis.drive.current_limit_ma()
            if limit_ma is not None and drive.lag() is not None and drive.current_ma() is not None:
                self._bounds[axis.name] = StallBounds(
                    axis.name, axis.unit, axis.description.max_following_error, limit_ma
                )
        self.require_inputs(axes, {axis.name: axis.drive.read_inputs() for axis in axes})

    def require_inputs(self, axes: Iterable[Axis], inputs: Mapping[str, Mapping[str, InputValue]]) -> None:
        """Require that every input is within its limits.

        Parameters
        ----------
        axes : iterable of Axis
            The axes.
        inputs : mapping
            Axis -> channel -> what it reads.

        Raises
        ------
        ForceGuardError
            Names each that is not.
        """
        if not self._holds_inputs:
            return
        excesses = [
            axis.description.inputs[name].find_excess(name, axis.name, value)
            for axis in axes
            for name, value in inputs[axis.name].items()
        ]
        raise_together([excess for excess in excesses if excess is not None])

    def period_s(self, axes: Iterable[Axis]) -> float:
        """Return how often the axes in motion have to be looked at [s]."""
        return min((self._period_s(axis) for axis in axes), default=math.inf)

    def _period_s(self, axis: Axis) -> float:
        bounds, expected = self._bounds.get(axis.name), axis.expected
        if bounds is None or not isinstance(expected, InMotion):
            return math.inf
        return bounds.period_s(expected.speed)

    def note_position(self, axis: Axis, reading: PositionReading) -> None:
        """Take a position that is read anyway: an axis that cannot lag by it needs no look for a while."""
        bounds, expected = self._bounds.get(axis.name), axis.expected
        if bounds is None or not isinstance(expected, InMotion):
            return
        # A fast axis has gone too far while its position was read.
        if bounds.is_suspect(2 * TIME_MARGIN_S * expected.speed):
            return
        if not bounds.is_suspect(bound_lag(expected, reading)):
            self._looked_s[axis.name], self._since_s[axis.name] = reading.until_s, None

    def require_moving(self, axes: Iterable[Axis], clock: Clock) -> None:
        """Look at each axis in motion that is due, and require that it is not stalled; one that is is stopped quickly.

        The following error is asked for first, and the current only of an axis that lags.

        Raises
        ------
        ForceGuardError, DriveError, BusError
        """
        for axis in axes:
            now_s, period_s = clock.now_s(), self._period_s(axis)
            if math.isinf(period_s):
                self._since_s.pop(axis.name, None)
            elif now_s - self._looked_s.get(axis.name, -math.inf) >= period_s - _EARLY_S:
                self._looked_s[axis.name] = now_s
                self._look(axis, now_s)

    def _look(self, axis: Axis, now_s: float) -> None:
        bounds, lag = self._bounds[axis.name], axis.drive.lag()
        if lag is None or not bounds.is_suspect(lag):
            self._since_s[axis.name] = None
            return
        reading = LoadReading(now_s, lag, axis.drive.current_ma() or 0.0)
        self._since_s[axis.name], error = supervise_stall(bounds, self._since_s.get(axis.name), reading)
        if error is not None:
            # A halt brakes as slowly as a move does: it would push on, and let the drive fail by its following error.
            with suppress(MachineError):
                axis.drive.stop(quick=True)
            raise error
