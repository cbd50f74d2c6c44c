"""Arms, points and seeds of a campaign: which task has which values, computed from its number alone."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from labrig.campaign.campaign_file import CampaignFile, Sample, show_value

Settings = Mapping[str, object]
"""Dotted key -> value."""


@dataclass(frozen=True)
class Arm:
    """An arm: its name, and the values of the keys by which it differs from the others."""

    name: str
    settings: Settings


@dataclass(frozen=True)
class TaskAddress:
    """Where a task stands in a campaign: number of the arm, of the point, and of the repetition; and its seed."""

    arm: int
    point: int
    repetition: int
    seed: int


def list_arms(campaign: CampaignFile) -> tuple[Arm, ...]:
    """Return the arms in the order of the file, the last key of `vary` changing fastest."""
    named: Mapping[str, Settings] = campaign.arms or {"": {}}
    shown = _shorten_keys(tuple(campaign.vary))
    arms = []
    for (name, settings), values in product(named.items(), product(*campaign.vary.values())):
        varied = dict(zip(campaign.vary, values, strict=True))
        parts = [name, *(f"{shown[key]}={show_value(value)}" for key, value in varied.items())]
        arms.append(Arm(", ".join(part for part in parts if part) or "base", {**settings, **varied}))
    return tuple(arms)


def _shorten_keys(keys: tuple[str, ...]) -> Mapping[str, str]:
    """Return the last part of each key; the whole key where several end alike."""
    ends = [key.rpartition(".")[2] for key in keys]
    return {key: end if ends.count(end) == 1 else key for key, end in zip(keys, ends, strict=True)}


def write_overrides(settings: Settings) -> tuple[str, ...]:
    """Return settings as `labrig run --set` takes them. Text is quoted, so that 16 and "16" remain two things."""
    return tuple(f"{key}={json.dumps(value)}" for key, value in settings.items())


def find_task(campaign: CampaignFile, number: int) -> TaskAddress:
    """Return the address of a task.

    The arm changes fastest and the repetition slowest: whatever number of tasks is done, all arms have been repeated
    equally often, give or take one.
    """
    rest, arm = divmod(number, campaign.arm_count)
    repetition, point = divmod(rest, campaign.points)
    return TaskAddress(arm, point, repetition, draw_seed(campaign.seed, point, repetition))


def draw_seed(campaign_seed: int, point: int, repetition: int) -> int:
    """Return the seed of a repetition at a point, which all arms share (common random numbers)."""
    return int(np.random.SeedSequence([campaign_seed, point, repetition]).generate_state(1)[0])


def find_point(campaign: CampaignFile, point: int) -> Settings:
    """Return the values of the sampled keys at a point; empty without a sample."""
    if campaign.sample is None:
        return {}
    keys = campaign.sample.keys
    units = _draw_units(campaign.sample.method, len(keys), campaign.sample.n, campaign.seed)[point]
    return {
        key: low + (high - low) * float(unit)
        for (key, (low, high)), unit in zip(keys.items(), units, strict=True)
    }


@cache
def _draw_units(method: str, keys: int, n: int, seed: int) -> NDArray[np.float64]:
    """Return the points (N, K) in the unit cube: a Latin hypercube, or a scrambled Sobol sequence (Owen 1998)."""
    random = np.random.default_rng([seed, 1])
    engine = (
        qmc.LatinHypercube(keys, rng=random) if method == "latin-hypercube" else qmc.Sobol(keys, rng=random)
    )
    return np.asarray(engine.random(n))


def list_extremes(sample: Sample | None) -> tuple[Settings, ...]:
    """Return the lowest and the highest values of the sampled keys, which are tried before a campaign begins."""
    if sample is None:
        return ()
    return tuple({key: limits[end] for key, limits in sample.keys.items()} for end in (0, 1))
