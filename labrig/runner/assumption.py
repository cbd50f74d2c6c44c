"""What a run took for granted, and how its virtual repetition turns each of it: for `labrig campaign --certify`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from labrig.analysis.outcome import TaskOutcome
from labrig.devices.rig_file import RigDescription
from labrig.protocol.sections import ExperimentProtocol

Settings = Mapping[str, object]
"""Dotted key -> value; `rig.` is of the rig."""

_FIRST_STEPS = 32.0
"""A margin beyond so many first steps, or standard deviations, needs no number."""


@dataclass(frozen=True)
class Assumption:
    """One thing that a run took for granted, and the key of the simulated world that turns it.

    The run goes on as if the stated value were true: only the world changes.

    Attributes
    ----------
    name, unit : str
        For people.
    key : str
        The key of the world that is turned.
    stated : float
        The value by which the run planned, in the unit.
    sd : float or None
        Its standard deviation as the protocol or the record states it; None if neither does.
    step : float
        The first step away from it where there is no standard deviation.
    lowest, highest : float
        Limits of what is tried; `stated` itself where there is only one direction.
    settings : callable
        Returns what to set for a value.
    whole : bool
        Whether only whole numbers make sense.
    """

    name: str
    unit: str
    key: str
    stated: float
    sd: float | None
    step: float
    lowest: float
    highest: float
    settings: Callable[[float], Settings]
    whole: bool = False

    @property
    def known_sd(self) -> float | None:
        """The stated standard deviation; None where there is none, or 0 is stated, of which no margin is a multiple."""
        return self.sd or None

    @property
    def first_step(self) -> float:
        """The first step away from the stated value: its standard deviation, or `step`."""
        return self.known_sd or self.step

    @property
    def limits(self) -> Mapping[int, float]:
        """How far away is tried, by direction (-1: below the stated value, 1: above it), at most 32 first steps."""
        ways = {-1: self.stated - self.lowest, 1: self.highest - self.stated}
        farthest = _FIRST_STEPS * self.first_step
        return {direction: min(limit, farthest) for direction, limit in ways.items() if limit > 0.0}


@dataclass(frozen=True)
class NotTried:
    """Something that the run took for granted and that the simulated world cannot turn, and why."""

    name: str
    why: str


@dataclass(frozen=True)
class VirtualRepeat:
    """How a run is repeated virtually.

    Attributes
    ----------
    protocol, rig
        With all that the run itself found out, such as a target that was clicked, and with a simulated world.
    simulate : callable
        `simulate(protocol, rig, seed) -> TaskOutcome`, pickled.
    arrives : callable
        Whether an outcome counts as an arrival.
    arrival : str
        The same in words.
    assumptions : sequence of Assumption
    not_tried : sequence of NotTried
    notes : sequence of str
        What is to be known of the world, as sentences.
    """

    protocol: ExperimentProtocol
    rig: RigDescription
    simulate: Callable[[ExperimentProtocol, RigDescription | None, int], TaskOutcome]
    arrives: Callable[[TaskOutcome], bool]
    arrival: str
    assumptions: Sequence[Assumption]
    not_tried: Sequence[NotTried]
    notes: Sequence[str]
