"""The result of a campaign: its arms, their differences, and its worst cases."""

from pathlib import Path
from typing import Literal

import pandas as pd

from labrig.campaign.inputs import LoadedCampaign
from labrig.campaign.sampling import Settings, find_point, list_arms, write_overrides
from labrig.campaign.statistics import (
    ArmResult,
    PairResult,
    compare_arms,
    judge_arm,
)
from labrig.protocol.model import Model

_WORST = 5


class WorstCase(Model):
    """A task of the largest values, or without any, and the command that makes it again as a run with pictures."""

    task: int
    arm: str
    value: float | None
    end: str
    command: tuple[str, ...]


class Failure(Model):
    """An error, and how many tasks ended with it."""

    error: str
    tasks: int
    first: int


class CampaignResult(Model):
    """What a campaign found.

    `table` is the file of its rows. `ended` says whether all of its tasks are done, a rule ended it before, or
    it can go on.
    """

    schema_version: Literal[1] = 1
    campaign: str
    title: str
    table: str
    base: str
    rig: str | None
    experiment: str
    depth: str
    measure: str
    tolerance: float | None
    tasks: int
    done: int
    failed: int
    ended: Literal["complete", "by_rule", "incomplete"]
    arms: tuple[ArmResult, ...]
    pairs: tuple[PairResult, ...]
    worst: tuple[WorstCase, ...]
    failures: tuple[Failure, ...]


def make_result(
    loaded: LoadedCampaign, table: pd.DataFrame, *, tasks: int, file: Path, by_rule: bool = False
) -> CampaignResult:
    """Return what the table of a campaign says.

    Parameters
    ----------
    table : DataFrame
        One row for each task that is done, in order.
    tasks : int
        The number of tasks if no rule ends it earlier.
    file : Path
        The table.
    by_rule : bool
        Whether a rule ended it.
    """
    campaign, by = loaded.file, loaded.by
    arms = list_arms(campaign)
    rows = {arm.name: table[table["arm"] == arm.name] for arm in arms}
    results = tuple(judge_arm(rows[arm.name], arm.name, arm.settings, by) for arm in arms)
    ended: Literal["complete", "by_rule", "incomplete"] = "complete" if len(table) == tasks else "incomplete"
    return CampaignResult(
        campaign=campaign.campaign,
        title=campaign.title,
        table=str(file),
        base=str(loaded.files.base),
        rig=None if loaded.rig is None else str(loaded.rig),
        experiment=loaded.experiment,
        depth=campaign.depth,
        measure=by.measure,
        tolerance=by.tolerance,
        tasks=tasks,
        done=len(table),
        failed=sum(arm.failed for arm in results),
        ended="by_rule" if by_rule else ended,
        arms=results,
        pairs=compare_arms(table, [arm.name for arm in arms], by) if len(arms) > 1 else (),
        worst=_find_worst(loaded, table),
        failures=_count_failures(table),
    )


def _find_worst(loaded: LoadedCampaign, table: pd.DataFrame) -> tuple[WorstCase, ...]:
    """Return the tasks with the largest values, those without any first."""
    campaign, measure = loaded.file, loaded.by.measure
    if measure not in table.columns:
        return ()
    sound = table[table["error"].isna()]
    ordered = sound.sort_values([measure, "task"], ascending=[False, True], na_position="first")
    arms = {arm.name: arm.settings for arm in list_arms(campaign)}
    cases = []
    for row in ordered.head(_WORST).to_dict("records"):
        settings = {**campaign.set, **arms[row["arm"]], **find_point(campaign, int(row["point"]))}
        value = row[measure]
        cases.append(
            WorstCase(
                task=int(row["task"]),
                arm=str(row["arm"]),
                value=None if pd.isna(value) else float(value),
                end=str(row["exit_status"]) if pd.isna(row["reason"]) else str(row["reason"]),
                command=write_command(loaded, int(row["seed"]), settings),
            )
        )
    return tuple(cases)


def write_command(loaded: LoadedCampaign, seed: int, settings: Settings) -> tuple[str, ...]:
    """Return the command that makes a task as a whole run, on the simulated rig with pictures."""
    of_rig = () if loaded.rig is None else ("--rig", str(loaded.rig))
    changes = (part for override in write_overrides(settings) for part in ("--set", override))
    return ("labrig", "run", str(loaded.files.base), *of_rig, "--seed", str(seed), *changes)


def _count_failures(table: pd.DataFrame) -> tuple[Failure, ...]:
    """Return the errors of tasks, the most frequent first."""
    failed = table[table["error"].notna()]
    found = [
        Failure(error=str(error), tasks=len(rows), first=int(rows["task"].min()))
        for error, rows in failed.groupby("error")
    ]
    return tuple(sorted(found, key=lambda failure: (-failure.tasks, failure.first)))
