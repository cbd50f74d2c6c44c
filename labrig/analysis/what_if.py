"""What an insertion would have been told with other planner, estimator or policy settings, on what was seen in it.

The step that steered the needle is taken again over the recorded sightings, with the settings of the run and with
others. The needle itself went where the run sent it: after the first command that differs the sightings are those of
another path, so that what follows there is a comparison of estimates, and no forecast.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from labrig.analysis.insertion_settings import insertion_settings, started_at
from labrig.errors import RecordError
from labrig.protocol import InsertionProtocol
from labrig.record import Run
from labrig.steering import (
    Obstacle,
    SteeringCommand,
    SteeringSettings,
    SteeringState,
    TipSighting,
    start_steering,
    step_steering,
)

_COMMAND = ("roll_rad", "observe_at_mm", "run_to_mm", "stop")


@dataclass(frozen=True)
class CommandDivergence:
    """The first command that differs: after which picture (None: before the first), at which depth, both values."""

    frame: int | None
    depth_mm: float
    what: str
    old: float | str | None
    new: float | str | None


@dataclass(frozen=True)
class Steered:
    """An insertion as one set of settings steers it: turns of the bevel, paths found after the first, how it ends."""

    turns: int
    replans: int
    stop: str | None
    tip_mm: tuple[float, float, float]
    turns_at_mm: tuple[float, ...]


@dataclass(frozen=True)
class WhatIf:
    """One insertion, steered by the settings of the run and by others.

    Attributes
    ----------
    trial : int
    sightings : int
        How often the tip was looked for.
    as_recorded : bool
        Whether the run's own settings give the estimates that were recorded, to the last digit.
    old, new : Steered
    divergence : CommandDivergence or None
        None where both give the same commands throughout.
    """

    trial: int
    sightings: int
    as_recorded: bool
    old: Steered
    new: Steered
    divergence: CommandDivergence | None


Step = tuple[SteeringState, SteeringCommand]


def steer_again(run: Run, other: InsertionProtocol) -> tuple[WhatIf, ...]:
    """Steer each insertion of a run again by the settings of another protocol.

    Raises
    ------
    RecordError
        When the run is no insertion, or its events do not say what was aimed at and seen.
    InputError
        When the other settings are no problem that can be planned.
    """
    if not isinstance(run.protocol, InsertionProtocol):
        raise RecordError(f"{run.path} is no insertion to a target")
    events = run.lines("events")
    try:
        return tuple(
            _steer_again(run.protocol, other, start, _of_trial(events, start["trial"]))
            for start in events
            if start["kind"] == "trial_start"
        )
    except (KeyError, TypeError) as error:
        raise RecordError(f"{run.path}: its events do not say {error}, which steering needs") from error


def _of_trial(events: Sequence[Mapping[str, Any]], trial: object) -> list[Mapping[str, Any]]:
    return [event for event in events if event.get("trial") == trial]


def _steer_again(
    protocol: InsertionProtocol,
    other: InsertionProtocol,
    start: Mapping[str, Any],
    events: Sequence[Mapping[str, Any]],
) -> WhatIf:
    observations = [event for event in events if event["kind"] == "observation"]
    target_mm = _point(start["target_mm"])
    obstacles = tuple(_obstacle(one) for one in start["obstacles"])
    old, new = (
        _steps(started_at(insertion_settings(one, target_mm, obstacles), events), observations)
        for one in (protocol, other)
    )
    return WhatIf(
        trial=int(start["trial"]),
        sightings=len(observations),
        as_recorded=_estimates(old[1:]) == [one["estimate"]["position_mm"] for one in observations],
        old=_steered(old),
        new=_steered(new),
        divergence=_first_divergence(old, new, observations),
    )


def _steps(settings: SteeringSettings, observations: Sequence[Mapping[str, Any]]) -> list[Step]:
    """Return states and commands: before the first sighting, then after each, until the step says stop."""
    steps = [start_steering(settings)]
    for seen in observations:
        state, command = steps[-1]
        if command.stop is not None:
            break
        position = None if seen["tip_mm"] is None else np.asarray(_point(seen["tip_mm"]))
        # Another command may have asked for a turn that was not made; the sighting stays where it was taken.
        depth_mm = max(float(seen["depth_mm"]), state.insertion_mm)
        steps.append(step_steering(state, TipSighting(depth_mm, position), settings))
    return steps


def _estimates(steps: Sequence[Step]) -> list[list[float]]:
    return [state.tip.position_mm.tolist() for state, _ in steps]


def _steered(steps: Sequence[Step]) -> Steered:
    last, command = steps[-1]
    turned = [state.insertion_mm for state, order in steps if order.roll_rad != 0.0]
    x_mm, y_mm, z_mm = last.tip.position_mm.tolist()
    return Steered(len(turned), last.replans, command.stop, (x_mm, y_mm, z_mm), tuple(turned))


def _first_divergence(
    old: Sequence[Step], new: Sequence[Step], observations: Sequence[Mapping[str, Any]]
) -> CommandDivergence | None:
    for number, ((state, before), (_, after)) in enumerate(zip(old, new, strict=False)):
        for what in _COMMAND:
            one, other = getattr(before, what), getattr(after, what)
            if one != other:
                frame = None if number == 0 else int(observations[number - 1]["frame"])
                return CommandDivergence(frame, state.insertion_mm, what, one, other)
    return None


def _point(values: Sequence[float]) -> tuple[float, float, float]:
    x_mm, y_mm, z_mm = values
    return float(x_mm), float(y_mm), float(z_mm)


def _obstacle(said: Mapping[str, Any]) -> Obstacle:
    return Obstacle(_point(said["position_mm"]), float(said["radius_mm"]))
