"""The result of a campaign: its arms, their differences, and its worst cases."""

from pathlib import Path
from typing import Literal

import pandas as pd

from labrig.campaign.statistics import (
    BROKEN_OFF,
    ArmResult,
    PairResult,
    compare_arms,
    correlate,
    count_alike,
    find_false_successes,
    judge_arm,
    name_ends,
)
from labrig.campaign.tasks import LoadedCampaign, write_overrides
from labrig.protocol.model import Model

_WORST = 5


class WorstCase(Model):
    """A task that failed, or of the largest values, and the command that makes it again as a run with pictures.

    One that was broken off has what was left of its way.
    """

    task: int
    arm: str
    value: float | None
    end: str
    command: tuple[str, ...]


class CampaignResult(Model):
    """What a campaign found.

    `rank_correlations` are Spearman's with each sampled key: of the measure, of being broken off, of having no value,
    of an interval that missed the truth.
    `table` is the file of its rows. `failures` counts the errors of tasks that were not computed.
    `ended` says whether all of its tasks are done, a rule ended it before, or it can go on.
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
    rank_correlations: dict[str, dict[str, float]]
    worst: tuple[WorstCase, ...]
    failures: dict[str, int]


def make_result(
    loaded: LoadedCampaign, table: pd.DataFrame, *, file: Path, by_rule: bool = False
) -> CampaignResult:
    """Return what the table of a campaign says.

    Parameters
    ----------
    table : DataFrame
        One row for each task that is done, in order.
    file : Path
        The table.
    by_rule : bool
        Whether a rule ended it.
    """
    campaign, by = loaded.file, loaded.by
    names = [arm.name for arm in loaded.arms]
    arms = tuple(
        judge_arm(table[table["arm"] == arm.name], arm.name, arm.settings, by) for arm in loaded.arms
    )
    return CampaignResult(
        campaign=campaign.campaign,
        title=campaign.title,
        table=str(file),
        base=str(loaded.base),
        rig=None if loaded.rig is None else str(loaded.rig),
        experiment=loaded.arms[0].protocol.experiment,
        depth=campaign.depth,
        measure=by.quantity,
        tolerance=by.tolerance,
        tasks=loaded.count,
        done=len(table),
        failed=sum(arm.failed for arm in arms),
        ended="by_rule" if by_rule else "complete" if len(table) >= loaded.count else "incomplete",
        arms=arms,
        pairs=compare_arms(table, names, by) if len(names) > 1 else (),
        rank_correlations=correlate(table, [*campaign.ranges], by),
        worst=_find_worst(loaded, table),
        failures=count_alike(table["error"].dropna()),
    )


def _find_worst(loaded: LoadedCampaign, table: pd.DataFrame) -> tuple[WorstCase, ...]:
    """Return the tasks that were wrongly called a success, then others that failed, then others; the largest first.

    Those that were broken off come after what came to its end.
    """
    measure, sound = loaded.by.quantity, table[table["error"].isna()]
    if measure not in table.columns:
        return ()
    ends = name_ends(sound)
    bad = 2 * find_false_successes(sound, loaded.by) + (ends != "success")
    rated = sound.assign(end=ends, bad=bad, off=ends == BROKEN_OFF)
    ordered = rated.sort_values(["bad", "off", measure, "task"], ascending=[False, True, False, True])
    return tuple(
        WorstCase(
            task=row["task"],
            arm=row["arm"],
            value=None if pd.isna(row[measure]) else row[measure],
            end=row["end"],
            command=_write_command(loaded, row["task"]),
        )
        for row in ordered.head(_WORST).to_dict("records")
    )


def _write_command(loaded: LoadedCampaign, number: int) -> tuple[str, ...]:
    """Return the command that makes a task as a whole run, on the simulated rig with pictures."""
    task = loaded.find_task(number)
    settings = write_overrides({**loaded.file.set, **task.arm.settings, **task.drawn})
    of_rig = () if loaded.rig is None else ("--rig", str(loaded.rig))
    changes = (part for setting in settings for part in ("--set", setting))
    return ("labrig", "run", str(loaded.base), *of_rig, "--seed", str(task.seed), *changes)
