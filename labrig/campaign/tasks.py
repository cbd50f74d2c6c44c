"""The tasks of a campaign: read with all that they are made from, known by their numbers, computed in workers."""

import json
import math
import os
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from labrig.analysis.engine import describe_installation
from labrig.analysis.experiment import TaskOutcome
from labrig.campaign.campaign_file import CampaignFile, load_campaign_file, show_value
from labrig.campaign.whole_run import run_whole
from labrig.devices.rig_file import RigDescription
from labrig.errors import FileFormatError, InputError, LabrigError, Problem, WorkersError
from labrig.experiments.declared import PROTOCOL_MODELS, find_experiment
from labrig.library.names import find_rig_file
from labrig.library.sources import fit_rig, load_rig_for, split_overrides
from labrig.protocol.load import load_protocol
from labrig.protocol.sections import Criterion, ExperimentProtocol
from labrig.protocol.yaml_file import SET, validate_values
from labrig.record.layout import hash_file
from labrig.runner.dry_run import simulate

Settings = Mapping[str, object]
"""Dotted key -> value; those that begin with `rig.` are of the rig."""


@dataclass(frozen=True)
class Arm:
    """An arm: its name, the values by which it differs from others, and what `labrig run` would read with them.

    Protocol and rig are whole, so that a worker reads no file but those of the calibration. `calibration` is the
    SHA-256 of each of them. The rig is None for an experiment that moves none.
    """

    name: str
    settings: Settings
    protocol: ExperimentProtocol
    rig: RigDescription | None
    calibration: Mapping[str, str]

    def describe(self) -> dict[str, object]:
        """Return protocol and rig as JSON."""
        models = {"protocol": self.protocol, "rig": self.rig}
        return {name: None if each is None else each.model_dump(mode="json") for name, each in models.items()}


@dataclass(frozen=True)
class Task:
    """A task: its number, and the arm, point, repetition and seed that follow from that.

    `drawn` are the values of the sampled keys at its point.
    """

    number: int
    arm: Arm
    point: int
    drawn: Settings
    repetition: int
    seed: int
    depth: str


@dataclass(frozen=True)
class LoadedCampaign:
    """A campaign whose files have been read.

    Attributes
    ----------
    file : CampaignFile
        Its content.
    base, rig : Path
        Protocol and rig file as seen from the working folder; no rig for an experiment that moves none.
    arms : tuple of Arm
        The last key of `vary` changes fastest.
    by : Criterion
        By what its tasks are judged.
    """

    file: CampaignFile
    base: Path
    rig: Path | None
    arms: tuple[Arm, ...]
    by: Criterion

    @property
    def count(self) -> int:
        """The number of tasks if no rule ends the campaign earlier."""
        return self.file.round_tasks * self.file.most_repetitions

    @cached_property
    def _points(self) -> NDArray[np.float64]:
        """Values (N, K) of the sampled keys: a Latin hypercube, or a scrambled Sobol sequence (Owen 1998)."""
        sample = self.file.sample
        if sample is None:
            return np.empty((1, 0))
        kind = qmc.LatinHypercube if sample.method == "latin-hypercube" else qmc.Sobol
        engine = kind(len(sample.keys), rng=np.random.default_rng([self.file.seed, 1]))
        return np.asarray(qmc.scale(engine.random(sample.n), *zip(*sample.keys.values(), strict=True)))

    def find_drawn(self, point: int) -> dict[str, object]:
        """Return the values of the sampled keys at a point; empty without a sample."""
        values = zip(self.file.ranges.items(), self._points[point].tolist(), strict=True)
        # In few digits, so that a command is readable and makes just this task.
        return {
            key: round(value, 5 - math.floor(math.log10(high - low))) for (key, (low, high)), value in values
        }

    def find_task(self, number: int) -> Task:
        """Return a task.

        The arm changes fastest and the repetition slowest: whatever number of tasks is done, all arms have been
        repeated equally often, give or take one. All arms share the seeds (common random numbers).
        """
        rest, arm = divmod(number, len(self.arms))
        repetition, point = divmod(rest, self.file.points)
        (seed,) = np.random.SeedSequence([self.file.seed, point, repetition]).generate_state(1)
        drawn = self.find_drawn(point)
        return Task(number, self.arms[arm], point, drawn, repetition, int(seed), self.file.depth)

    def list_tasks(self, begin: int = 0) -> Iterator[Task]:
        """Yield the tasks from a number on."""
        return map(self.find_task, range(begin, self.count))

    def describe(self) -> dict[str, object]:
        """Return all that decides the rows of a campaign, as JSON.

        How many there are, and how they are judged, is left out unless a rule looks at it: a campaign may go on with
        more repetitions.
        """
        rule = self.file.stop_when
        looked_at = {"repetitions": self.file.repetitions, "measure": self.by.quantity}
        free = {"title", "tolerance", "base", "rig", "stop_when", *looked_at}
        arms = [arm.describe() for arm in self.arms]
        return {
            "installation": describe_installation(),
            "rule": None if rule is None else {**rule.model_dump(mode="json"), **looked_at},
            "campaign": self.file.model_dump(mode="json", exclude=free),
            **arms[0],
            "calibration": self.arms[0].calibration,
            "sha256_of_arms": sha256(json.dumps(arms).encode()).hexdigest(),
        }


def load_campaign(
    path: Path,
    *,
    settings: Sequence[str] = (),
    rig: Path | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> LoadedCampaign:
    """Read a campaign and all that it names, relative to its own folder.

    Parameters
    ----------
    settings : sequence of str
        `key=value` each; they replace values of the campaign file.
    rig : Path or None
        Takes the place of the rig that the file names.
    progress : callable
        Told the share of the arms that was read.

    Raises
    ------
    FileFormatError
        With every problem of the file, or of an arm.
    InputError
        When the rig is not simulated, the experiment cannot be computed without pictures, or nothing says by what it
        is judged.
    """
    file = load_campaign_file(path, settings)
    base = Path(os.path.normpath(path.parent / file.base))
    if rig is None and file.rig is not None:
        rig = Path(os.path.normpath(path.parent / file.rig))
    arms: list[Arm] = []
    for name, values in list_arms(file).items():
        try:
            arms.append(_load_arm(file, base, rig, name, values))
        except FileFormatError as error:
            where = f"{path}, arm {name}:"
            told = (replace(each, where=each.where.replace(str(SET), where)) for each in error.problems)
            raise FileFormatError(tuple(told)) from error
        progress(len(arms) * file.points / file.round_tasks)
    first = arms[0].protocol
    if file.depth == "world" and find_experiment(first.experiment).find_part("tell_values") is None:
        raise InputError(
            f"{path}: the experiment {first.experiment} is not computed without pictures",
            "say depth: rig, which makes whole runs on a simulated rig",
        )
    own = first.criterion
    if own is None and file.measure is None:
        raise InputError(
            f"{path}: nothing says by what the experiment {first.experiment} is judged",
            "add measure: NAME, a quantity of its result",
        )
    by = own if own is not None and file.measure in {None, own.quantity} else Criterion(str(file.measure))
    by = by if file.tolerance is None else replace(by, tolerance=file.tolerance)
    named = None if arms[0].rig is None else find_rig_file(rig, base)
    return LoadedCampaign(file, base, named, tuple(arms), by)


def list_arms(campaign: CampaignFile) -> dict[str, Settings]:
    """Return the values of each arm by its name: the last part of each key, the whole key where several end alike."""
    ends = [key.rpartition(".")[2] for key in campaign.vary]
    shown = [end if ends.count(end) == 1 else key for key, end in zip(campaign.vary, ends, strict=True)]
    arms: dict[str, Settings] = {}
    for (name, own), values in product((campaign.arms or {"": {}}).items(), product(*campaign.vary.values())):
        parts = [name, *(f"{key}={show_value(value)}" for key, value in zip(shown, values, strict=True))]
        arms[", ".join(filter(None, parts)) or "base"] = {
            **own,
            **dict(zip(campaign.vary, values, strict=True)),
        }
    return arms


def write_overrides(settings: Settings) -> tuple[str, ...]:
    """Return settings as `labrig run --set` takes them. Text is quoted, so that 16 and "16" remain two things."""
    return tuple(f"{key}={json.dumps(value)}" for key, value in settings.items())


def _load_arm(file: CampaignFile, base: Path, rig: Path | None, name: str, values: Settings) -> Arm:
    """Read an arm; the ends of the sampled ranges are tried too, so that nothing is refused after the first task."""
    of_protocol, of_rig = split_overrides(write_overrides({**file.set, **values}))
    protocol = load_protocol(base, PROTOCOL_MODELS, of_protocol)
    found = load_rig_for(protocol, base, rig, of_rig)
    repeated = getattr(protocol, "repetitions", 1)
    if file.depth == "world" and repeated > 1:
        message = (
            f"a run of the protocol makes {repeated} insertions, and depth: world computes one for each task"
        )
        hint = "add set: {repetitions: 1}; the campaign's own repetitions say how often, or say depth: rig"
        raise FileFormatError((Problem(f"{SET} repetitions", message, hint),))
    if found is None:
        arm = Arm(name, values, protocol, None, {})
    else:
        arm = Arm(name, values, protocol, _detach(found), _hash_calibration(found))
    for end in (0, 1) if file.ranges else ():
        make_models(arm, {key: limits[end] for key, limits in file.ranges.items()}, file.seed)
    return arm


def _detach(rig: RigDescription) -> RigDescription:
    """Return a rig for any process: of an absolute folder, without state file and real clock, so nobody is asked."""
    if rig.kind != "simulated":
        raise InputError(
            f"the rig {rig.name} is {rig.kind}, and a campaign moves simulated rigs only",
            "name a simulated rig as rig: in the campaign file",
        )
    return rig.model_copy(update={"state_file": None, "clock": None}).placed_in(rig.folder.absolute())


def _hash_calibration(rig: RigDescription) -> dict[str, str]:
    return {name: hash_file(path) for name, path in sorted(rig.calibration_files().items())}


def make_models(arm: Arm, drawn: Settings, seed: int) -> tuple[ExperimentProtocol, RigDescription | None]:
    """Return protocol and rig of a task: those of its arm with the values of its point, and its seed.

    Raises
    ------
    FileFormatError
        When the values do not go together.
    """
    protocol, rig = arm.protocol, arm.rig
    of_protocol, of_rig = split_overrides(write_overrides(drawn))
    if of_protocol:
        protocol = validate_values(protocol.model_dump(mode="json"), "campaign", type(protocol), of_protocol)
    if of_rig and rig is not None:
        changed = validate_values(rig.model_dump(mode="json"), "campaign", RigDescription, of_rig)
        rig = changed.placed_in(rig.folder)
    return protocol.model_copy(update={"seed": seed}), fit_rig(protocol, rig)


def compute_task(task: Task) -> TaskOutcome:
    """Return what comes of a task.

    Raises
    ------
    WorkersError
        When this computer does not see the calibration that the campaign began with: no other task can be computed.
    LabrigError
        When this one cannot be computed.
    """
    protocol, rig = make_models(task.arm, task.drawn, task.seed)
    if rig is not None and _hash_calibration(rig) != task.arm.calibration:
        raise WorkersError(
            f"a worker on {platform.node()} does not see the calibration files of {rig.folder} that the campaign "
            "began with",
            "keep the lab folder where all workers have it under the same name, and leave it as it is meanwhile",
        )
    experiment = find_experiment(protocol.experiment)
    if task.depth == "world":
        return simulate(experiment, protocol, rig, task.seed)
    return run_whole(experiment, protocol, rig)


def make_row(task: Task, outcome: TaskOutcome | LabrigError) -> dict[str, object]:
    """Return the row of a task in the table: what it is, its values, and what came of it."""
    settings = {**task.arm.settings, **task.drawn}
    if isinstance(outcome, LabrigError):
        ended: dict[str, object] = {"exit_status": None, "reason": None, "error": outcome.message}
    else:
        end = {"exit_status": outcome.exit_status, "reason": outcome.reason, "error": None}
        ended = {**end, **outcome.values}
    return {
        "task": task.number,
        "arm": task.arm.name,
        "point": task.point,
        "repetition": task.repetition,
        "seed": task.seed,
        **{key: _make_cell(value) for key, value in settings.items()},
        **ended,
    }


def _make_cell(value: object) -> object:
    return value if value is None or isinstance(value, int | float) else show_value(value)
