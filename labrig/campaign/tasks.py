"""The tasks of a campaign: what a worker computes of each, and the row that it becomes."""

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from hashlib import sha256

from labrig.analysis.experiment import TaskOutcome
from labrig.campaign.campaign_file import CampaignFile, show_value
from labrig.campaign.inputs import ArmInputs, LoadedCampaign, make_models, require_calibration
from labrig.campaign.sampling import Arm, Settings, find_point, find_task, list_arms
from labrig.campaign.statistics import require_measure
from labrig.campaign.store import FIXED, CampaignPlan
from labrig.campaign.whole_run import run_whole
from labrig.errors import LabrigError
from labrig.experiments.registry import find_experiment
from labrig.runner.dry_run import simulate

Cell = bool | int | float | str | None
Row = Mapping[str, Cell]


@dataclass(frozen=True)
class TaskOrder:
    """What a worker is told of a task: protocol and rig of its arm, values of its point, its seed, and the depth."""

    inputs: ArmInputs
    settings: Settings
    seed: int
    depth: str


def compute_task(order: TaskOrder) -> TaskOutcome:
    """Return what comes of a task. Raises `LabrigError` when it cannot be computed."""
    require_calibration(order.inputs)
    protocol, rig = make_models(order.inputs, order.settings, order.seed)
    experiment = find_experiment(order.inputs.experiment)
    if order.depth == "world":
        return simulate(experiment, protocol, rig, order.seed)
    return run_whole(experiment, protocol, rig)


@dataclass(frozen=True)
class CampaignTasks:
    """All tasks of a campaign: orders for workers, and rows of what came of them.

    Parameters
    ----------
    loaded : LoadedCampaign
        The campaign.
    """

    loaded: LoadedCampaign

    @property
    def campaign(self) -> CampaignFile:
        """What the file says."""
        return self.loaded.file

    @property
    def arms(self) -> tuple[Arm, ...]:
        """The arms."""
        return list_arms(self.campaign)

    @property
    def round_tasks(self) -> int:
        """The number of tasks of one repetition of all arms at all points."""
        return self.campaign.arm_count * self.campaign.points

    @property
    def count(self) -> int:
        """The number of tasks if no rule ends the campaign earlier."""
        return self.round_tasks * self.campaign.most_repetitions

    def list_orders(self, begin: int) -> Iterator[TaskOrder]:
        """Yield the orders from a task on."""
        for number in range(begin, self.count):
            address = find_task(self.campaign, number)
            point = find_point(self.campaign, address.point)
            yield TaskOrder(self.loaded.inputs[address.arm], point, address.seed, self.campaign.depth)

    def make_rows(self, begin: int, outcomes: Iterable[TaskOutcome | LabrigError]) -> Iterator[Row]:
        """Yield the rows of consecutive tasks. Raises `InputError` when they do not have the measure."""
        arms = self.arms
        for number, outcome in enumerate(outcomes, start=begin):
            if isinstance(outcome, TaskOutcome) and outcome.values:
                require_measure(self.loaded.by, outcome.values)
            address = find_task(self.campaign, number)
            arm = arms[address.arm]
            settings = {**arm.settings, **find_point(self.campaign, address.point)}
            yield {
                "task": number,
                "arm": arm.name,
                "point": address.point,
                "repetition": address.repetition,
                "seed": address.seed,
                **{key: _make_cell(settings.get(key)) for key in self.campaign.varied_keys},
                **_describe_outcome(outcome),
            }


def _describe_outcome(outcome: TaskOutcome | LabrigError) -> Row:
    if isinstance(outcome, LabrigError):
        return {"exit_status": None, "reason": None, "error": outcome.message}
    return {
        "exit_status": outcome.exit_status,
        "reason": outcome.reason,
        "error": None,
        **outcome.values,
    }


def _make_cell(value: object) -> Cell:
    return value if value is None or isinstance(value, bool | int | float | str) else show_value(value)


def list_values(row: Row, campaign: CampaignFile) -> Row:
    """Return the quantities of a row; none of a task that failed."""
    return {name: value for name, value in row.items() if name not in {*FIXED, *campaign.varied_keys}}


def describe_campaign(loaded: LoadedCampaign) -> dict[str, object]:
    """Return all that decides the rows of a campaign, as JSON; not how many there are, nor how they are judged.

    So a campaign can go on with more repetitions. What may be changed of these is the store's to say (`CampaignPlan`).
    """
    free = {"title", "repetitions", "stop_when", "measure", "tolerance", "base", "rig"}
    first = loaded.inputs[0]
    arms = sha256("\n".join(f"{arm.protocol}\n{arm.rig}" for arm in loaded.inputs).encode())
    return {
        "campaign": loaded.file.model_dump(mode="json", exclude=free),
        "protocol": json.loads(first.protocol),
        "rig": None if first.rig is None else json.loads(first.rig),
        "calibration": dict(first.calibration),
        "sha256_of_arms": arms.hexdigest(),
    }


def plan_campaign(loaded: LoadedCampaign) -> CampaignPlan:
    """Return how many tasks a campaign has, and the rule that may end it earlier."""
    campaign, measure = loaded.file, loaded.by.measure
    rule = campaign.stop_when
    return CampaignPlan(
        arms=campaign.arm_count,
        tasks=CampaignTasks(loaded).count,
        measure=measure,
        rule=None
        if rule is None
        else {**rule.model_dump(mode="json"), "first_look": campaign.first_look(), "measure": measure},
    )
