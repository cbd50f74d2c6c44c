"""The certificate of a run: its virtual repetitions in worlds in which one thing that it took for granted is wrong."""

import math
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import datetime

from labrig.analysis.certificate import Arrivals, Certificate, Margin, NotTriedPart, TriedValue
from labrig.analysis.outcome import TaskOutcome
from labrig.campaign.inputs import ArmInputs, describe_inputs, make_models, require_calibration
from labrig.campaign.margin_search import (
    Tallies,
    Tally,
    Way,
    estimate_left,
    find_answer,
    find_next,
    find_safe,
    find_sure_sides,
)
from labrig.campaign.sampling import Settings, draw_seed
from labrig.devices.replayed.opening import load_recorded_rig
from labrig.devices.rig_file import RigDescription
from labrig.errors import BugError, InputError, LabrigError, MachineError
from labrig.experiments.registry import find_run_experiment, load_run_protocol
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.reader import Run
from labrig.runner.assumption import Assumption, VirtualRepeat

_RIG_FILE = "rig.yaml"


@dataclass(frozen=True)
class RepeatOrder:
    """What a worker is told of one repetition: how to simulate, protocol and rig, what is turned, and the seed."""

    simulate: Callable[[ExperimentProtocol, RigDescription | None, int], TaskOutcome]
    inputs: ArmInputs
    settings: Settings
    seed: int


def compute_repetition(order: RepeatOrder) -> TaskOutcome:
    """Return what comes of a repetition. Raises `LabrigError` when it cannot be made."""
    require_calibration(order.inputs)
    protocol, rig = make_models(order.inputs, order.settings, order.seed)
    return order.simulate(protocol, rig, order.seed)


Compute = Callable[[Iterable[RepeatOrder]], Generator[TaskOutcome | LabrigError, None, None]]
"""Returns what comes of each repetition, in their order."""

Watch = Callable[[int, int], None]
"""Is told how many repetitions are done, and roughly how many are left."""


def prepare_repeat(run: Run) -> VirtualRepeat:
    """Return how a run is repeated virtually.

    Raises
    ------
    InputError
        When the run has not ended, its experiment takes nothing for granted that could be turned, or it cannot be
        repeated.
    RecordError
        When what is needed of the record is damaged.
    """
    experiment = find_run_experiment(run)
    if not experiment.can_certify:
        experiment.part("assumptions")  # raises, with the reason
    if run.withdraws is not None or run.manifest.get("exit_status") == "incomplete":
        what = "only withdrew a needle" if run.withdraws is not None else "has not ended"
        raise InputError(
            f"{run.path} {what}, and an insertion that has ended is certified", "name another run"
        )
    return experiment.list_assumptions(run, load_run_protocol(run), load_recorded_rig(run))


@dataclass(frozen=True)
class _Search:
    """The search of one assumption in one direction, and what it has found."""

    assumption: Assumption
    direction: int
    way: Way
    tallies: Tallies

    @classmethod
    def list_all(cls, assumptions: Sequence[Assumption]) -> "list[_Search]":
        """Return the searches of all assumptions, both directions of each that has two."""
        return [
            cls(turned, direction, Way(turned.first_step, limit, turned.known_sd, turned.whole), {})
            for turned in assumptions
            for direction, limit in turned.limits.items()
        ]

    def value_at(self, distance: float) -> float:
        """Return the value at a distance from the stated one."""
        return self.assumption.stated + self.direction * distance

    def settings_at(self, distance: float) -> Settings:
        """Return what is set there."""
        return self.assumption.settings(self.value_at(distance))

    def with_tally(self, distance: float, tally: Tally) -> "_Search":
        """Return this search with what was found at a distance."""
        return _Search(self.assumption, self.direction, self.way, {**self.tallies, distance: tally})


@dataclass(frozen=True)
class Found:
    """What the virtual repetitions of a run found.

    Attributes
    ----------
    repeat : VirtualRepeat
    base : Tally
        Nothing turned.
    searches : sequence
        Of each assumption and direction.
    repetitions : int
        At each value at most.
    insertions : int
        Repetitions in all.
    """

    repeat: VirtualRepeat
    base: Tally
    searches: Sequence[_Search]
    repetitions: int
    insertions: int


def certify(repeat: VirtualRepeat, compute: Compute, watch: Watch, *, repetitions: int) -> Found:
    """Search how far each assumption of a run may be wrong before fewer than half of its repetitions arrive.

    Parameters
    ----------
    repetitions : int
        At each value at most, at least 2.

    Raises
    ------
    LabrigError
        When the run as it was cannot be repeated, or no repetition can be computed.
    """
    inputs = make_inputs(repeat)
    untried = _Search.list_all(repeat.assumptions)
    progress = _Progress(watch, repetitions + _estimate_left(untried, repetitions))
    (base,) = _repeat_at(repeat, inputs, compute, [_Trying({}, Tally(), repetitions)], progress, base=True)
    searches = untried if 2 * base.arrived >= base.n else []
    while asked := [
        (number, ask)
        for number, search in enumerate(searches)
        if (ask := find_next(search.way, search.tallies, repetitions))
    ]:
        progress.left = _estimate_left(searches, repetitions)
        tryings = [
            _Trying(
                searches[number].settings_at(ask.distance),
                searches[number].tallies.get(ask.distance, Tally()),
                ask.repetitions,
            )
            for number, ask in asked
        ]
        tallies = _repeat_at(repeat, inputs, compute, tryings, progress)
        for (number, ask), tally in zip(asked, tallies, strict=True):
            searches[number] = searches[number].with_tally(ask.distance, tally)
    return Found(repeat, base, searches, repetitions, progress.done)


def _estimate_left(searches: Sequence[_Search], repetitions: int) -> int:
    return sum(estimate_left(search.way, search.tallies, repetitions) for search in searches)


def make_inputs(repeat: VirtualRepeat) -> ArmInputs:
    """Return protocol and rig of a virtual repetition as documents."""
    return describe_inputs("certificate", repeat.protocol, repeat.rig, repeat.rig.folder / _RIG_FILE)


class _Progress:
    """Tells the watch how many repetitions are done, and roughly how many are left."""

    def __init__(self, watch: Watch, left: int) -> None:
        self.done = 0
        self.left = left
        self._watch = watch

    def step(self) -> None:
        """Count one more."""
        self.done += 1
        self.left = max(0, self.left - 1)
        self._watch(self.done, self.left)


@dataclass(frozen=True)
class _Trying:
    """What is set, what was found with it, and how often it is to be repeated in all."""

    settings: Settings
    tally: Tally
    repetitions: int


def _repeat_at(
    repeat: VirtualRepeat,
    inputs: ArmInputs,
    compute: Compute,
    tryings: Sequence[_Trying],
    progress: _Progress,
    *,
    base: bool = False,
) -> list[Tally]:
    """Return what is found with all settings after the repetitions that they still lack; seeds are the same for all."""
    places = [
        (place, repetition)
        for place, trying in enumerate(tryings)
        for repetition in range(trying.tally.n, trying.repetitions)
    ]
    orders = (
        RepeatOrder(
            repeat.simulate,
            inputs,
            tryings[place].settings,
            draw_seed(repeat.protocol.seed, 0, repetition),
        )
        for place, repetition in places
    )
    tallies = [trying.tally for trying in tryings]
    with closing(compute(orders)) as outcomes:
        for (place, _), outcome in zip(places, outcomes, strict=True):
            tallies[place] = tallies[place].add(_find_end(repeat, outcome, base=base))
            progress.step()
    return tallies


def _find_end(repeat: VirtualRepeat, outcome: TaskOutcome | LabrigError, *, base: bool) -> str | None:
    """Return how a repetition ended; None if it arrived. Raises an error that is not the turned value's."""
    if isinstance(outcome, LabrigError):
        if base or isinstance(outcome, BugError | MachineError):
            raise outcome
        return f"refused: {outcome.message}"
    if repeat.arrives(outcome):
        return None
    return outcome.reason or "elsewhere, believed to be at the target"


def make_certificate(
    run: Run, found: Found, *, created: datetime, provenance: Mapping[str, object]
) -> Certificate:
    """Return the document of what was found, the smallest margins in standard deviations first."""
    repeat = found.repeat
    margins = sorted((_make_margin(search, found.repetitions) for search in found.searches), key=_rank)
    return Certificate(
        run=run.path.name,
        experiment=repeat.protocol.experiment,
        created=created.isoformat(timespec="seconds"),
        provenance=dict(provenance),
        arrival=repeat.arrival,
        notes=tuple(repeat.notes),
        seed=repeat.protocol.seed,
        repetitions=found.repetitions,
        insertions=found.insertions,
        base=_make_arrivals(found.base),
        margins=tuple(margins),
        not_tried=tuple(NotTriedPart(name=part.name, why=part.why) for part in repeat.not_tried),
    )


def _make_margin(search: _Search, repetitions: int) -> Margin:
    turned, tallies, way = search.assumption, search.tallies, search.way

    def value_at(distance: float | None) -> float | None:
        return None if distance is None else search.value_at(distance)

    def tried_at(distance: float) -> TriedValue:
        tally = tallies[distance]
        ends = dict(sorted(tally.ends.items(), key=lambda item: -item[1]))
        return TriedValue(value=search.value_at(distance), arrivals=_make_arrivals(tally), ends=ends)

    answer = find_answer(way, tallies, repetitions)
    more, fewer = find_sure_sides(tallies, answer)
    return Margin(
        name=turned.name,
        unit=turned.unit,
        key=turned.key,
        direction=1 if search.direction > 0 else -1,
        stated=turned.stated,
        sd=turned.known_sd,
        misses_at=None if answer is None else tried_at(answer),
        half_between=(value_at(more), value_at(fewer)),
        arrives_to=value_at(find_safe(tallies)),
        farthest=search.value_at(max(tallies)),
        at_sds=tuple(tried_at(distance) for distance in way.at_sds),
        tried=tuple(tried_at(distance) for distance in sorted(tallies)),
    )


def _make_arrivals(tally: Tally) -> Arrivals:
    return Arrivals(n=tally.n, arrived=tally.arrived, share_ci95=tally.interval)


def _rank(margin: Margin) -> tuple[bool, bool, float]:
    """Return the place in the list: by margin in standard deviations; those that never miss behind, others last."""
    reach = margin.tried_sds if margin.margin_sds is None else margin.margin_sds
    return margin.sd is None, margin.misses_at is None, math.inf if reach is None else reach
