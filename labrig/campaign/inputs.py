"""What a task is made from: protocol and rig of its arm as documents, so that a worker needs none of their files."""

import json
import platform
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import cast

from labrig.campaign.campaign_file import CampaignFile
from labrig.campaign.sampling import Arm, Settings, list_arms, list_extremes, write_overrides
from labrig.campaign.statistics import Judgement
from labrig.devices.rig_file import RigDescription, load_rig
from labrig.errors import FileFormatError, InputError, Problem, WorkersError
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.registry import find_experiment
from labrig.protocol.formatting import Plain
from labrig.protocol.load import load_protocol
from labrig.protocol.overrides import SET, apply_overrides
from labrig.protocol.sections import ExperimentProtocol, Needle
from labrig.protocol.tree import EntryPosition, Position, Tree
from labrig.protocol.yaml_file import validate_tree
from labrig.record.layout import hash_file

RIG_PREFIX = "rig."


@dataclass(frozen=True)
class ArmInputs:
    """Protocol and rig of an arm, with all that other files fill in.

    Attributes
    ----------
    name : str
        The arm.
    experiment : str
        The name of the experiment.
    protocol, rig : str
        As JSON; the rig is None for an experiment that moves none.
    rig_file : Path or None
        Where the rig file is: calibration files are beside it. Absolute, as a worker is in another working folder.
    calibration : tuple
        Name and SHA-256 of each calibration file that the rig names.
    """

    name: str
    experiment: str
    protocol: str
    rig: str | None
    rig_file: Path | None
    calibration: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class CampaignFiles:
    """Where a campaign's files are: itself, its base protocol, and its rig file.

    `find_rig` returns the latter; it is asked only for an experiment that moves a rig, and raises `InputError` without
    one.
    """

    campaign: Path
    base: Path
    find_rig: Callable[[], Path]


@dataclass(frozen=True)
class LoadedCampaign:
    """A campaign whose files have been read.

    Attributes
    ----------
    files : CampaignFiles
    file : CampaignFile
        Its content.
    inputs : tuple of ArmInputs
        Of each arm, in the order of `list_arms`.
    by : Judgement
        By what its tasks are judged.
    """

    files: CampaignFiles
    file: CampaignFile
    inputs: tuple[ArmInputs, ...]
    by: Judgement

    @property
    def experiment(self) -> str:
        """The name of its experiment."""
        return self.inputs[0].experiment

    @property
    def rig(self) -> Path | None:
        """The rig file, as seen from the working folder if it is below; None for an experiment that moves none."""
        file, here = self.inputs[0].rig_file, Path.cwd()
        return file.relative_to(here) if file is not None and file.is_relative_to(here) else file


def load_campaign(
    files: CampaignFiles, file: CampaignFile, progress: Callable[[float], None] = lambda _: None
) -> LoadedCampaign:
    """Read protocol and rig of every arm.

    Parameters
    ----------
    progress : callable
        Told the share of the arms that was read.

    Raises
    ------
    FileFormatError
        With every problem of an arm.
    InputError
        When the arms are of several experiments, the rig is not simulated, the experiment cannot be computed without
        pictures, or nothing says by what it is judged.
    """
    arms, inputs = list_arms(file), []
    for number, arm in enumerate(arms, start=1):
        inputs.append(_load_arm(files, file, arm))
        progress(number / len(arms))
    others = [arm for arm in inputs if arm.experiment != inputs[0].experiment]
    if others:
        raise InputError(
            f"{files.campaign}: the arm {others[0].name} is of the experiment {others[0].experiment}, and the arm "
            f"{inputs[0].name} of {inputs[0].experiment}",
            "make a campaign for each",
        )
    if file.depth == "world" and not find_experiment(inputs[0].experiment).can_simulate:
        raise InputError(
            f"{files.campaign}: the experiment {inputs[0].experiment} is not computed without pictures",
            "say depth: rig, which makes whole runs on a simulated rig",
        )
    return LoadedCampaign(files, file, tuple(inputs), _find_judgement(files, file, inputs[0]))


def _find_judgement(files: CampaignFiles, file: CampaignFile, first: ArmInputs) -> Judgement:
    own = make_models(first, {}, file.seed)[0].criterion
    if file.measure is not None and (own is None or own.quantity != file.measure):
        return Judgement(file.measure, file.tolerance)
    if own is None:
        raise InputError(
            f"{files.campaign}: nothing says by what the experiment {first.experiment} is judged",
            "add measure: NAME, a quantity of its result",
        )
    return Judgement(own.quantity, own.tolerance if file.tolerance is None else file.tolerance)


def _load_arm(files: CampaignFiles, campaign: CampaignFile, arm: Arm) -> ArmInputs:
    """Read protocol and rig of an arm, as `labrig run` reads them with the arm's values behind `--set`.

    The ends of the sampled ranges are tried too, so that a campaign is refused before its first task.

    Raises
    ------
    FileFormatError
        With every problem, and the arm.
    InputError
        When the rig is not simulated, or is given for an experiment that moves none.
    """
    settings = {**campaign.set, **arm.settings}
    try:
        inputs = _load(files, arm.name, settings)
        _require_one_insertion(inputs, campaign.depth)
        for point in list_extremes(campaign.sample):
            make_models(inputs, point, campaign.seed)
    except FileFormatError as error:
        where = f"{files.campaign}, arm {arm.name}:"
        raise FileFormatError(
            tuple(
                replace(problem, where=problem.where.replace(str(SET), where)) for problem in error.problems
            )
        ) from error
    return inputs


def _require_one_insertion(inputs: ArmInputs, depth: str) -> None:
    """Refuse a run of several insertions where a task is one. Raises `FileFormatError`."""
    made = json.loads(inputs.protocol).get("repetitions", 1)
    if depth == "world" and made > 1:
        message = (
            f"a run of the protocol makes {made} insertions, and depth: world computes one for each task"
        )
        hint = "add set: {repetitions: 1}; the campaign's own repetitions say how often, or say depth: rig"
        raise FileFormatError((Problem(f"{SET} repetitions", message, hint),))


def _load(files: CampaignFiles, name: str, settings: Settings) -> ArmInputs:
    of_protocol, of_rig = split_settings(settings)
    protocol = load_protocol(files.base, PROTOCOL_MODELS, write_overrides(of_protocol))
    if not find_experiment(protocol.experiment).moves_rig:
        if of_rig:
            raise InputError(
                f"{files.campaign} changes {RIG_PREFIX}{next(iter(of_rig))}, and the experiment {protocol.experiment} "
                "moves no rig",
                "leave it out",
            )
        return ArmInputs(name, protocol.experiment, protocol.model_dump_json(), None, None)
    file = files.find_rig()
    rig = load_rig(file, write_overrides(of_rig))
    if rig.kind != "simulated":
        raise InputError(
            f"the rig {rig.name} is {rig.kind}, and a campaign moves simulated rigs only",
            "name a simulated rig as rig: in the campaign file",
        )
    return describe_inputs(name, protocol, rig, file)


def describe_inputs(name: str, protocol: ExperimentProtocol, rig: RigDescription, file: Path) -> ArmInputs:
    """Return protocol and rig as documents, without state file and real clock: nothing is left behind, nobody asked."""
    document = rig.model_copy(update={"state_file": None, "clock": None}).model_dump_json()
    return ArmInputs(
        name,
        protocol.experiment,
        protocol.model_dump_json(),
        document,
        file.absolute(),
        tuple(sorted(_hash_calibration(rig).items())),
    )


def _hash_calibration(rig: RigDescription) -> dict[str, str]:
    """Return the SHA-256 of each calibration file of a rig that is there."""
    return {name: hash_file(path) for name, path in rig.calibration_files().items()}


def split_settings(settings: Settings) -> tuple[dict[str, object], dict[str, object]]:
    """Split settings into those of the protocol and those of the rig, these without the prefix `rig.`."""
    rig = {
        key.removeprefix(RIG_PREFIX): value for key, value in settings.items() if key.startswith(RIG_PREFIX)
    }
    return {key: value for key, value in settings.items() if not key.startswith(RIG_PREFIX)}, rig


def make_models(
    inputs: ArmInputs, settings: Settings, seed: int
) -> tuple[ExperimentProtocol, RigDescription | None]:
    """Return protocol and rig of a task: those of its arm with the values of its point, and its seed.

    Raises
    ------
    FileFormatError
        When the values do not go together.
    """
    protocol, rig = _read_arm(inputs)
    if settings:
        of_protocol, of_rig = split_settings(settings)
        protocol = validate_tree(_change(inputs.protocol, of_protocol), type(protocol))
        rig = None if rig is None else _place(_change(cast("str", inputs.rig), of_rig), inputs)
    needle = getattr(protocol, "needle", None)
    if rig is not None and isinstance(needle, Needle):
        rig = rig.with_needle(needle)
    return protocol.model_copy(update={"seed": seed}), rig


@lru_cache(maxsize=64)
def _read_arm(inputs: ArmInputs) -> tuple[ExperimentProtocol, RigDescription | None]:
    protocol = validate_tree(_change(inputs.protocol, {}), PROTOCOL_MODELS[inputs.experiment])
    return protocol, None if inputs.rig is None else _place(_change(inputs.rig, {}), inputs)


def _change(document: str, settings: Settings) -> Tree:
    values: Plain = json.loads(document)
    tree = Tree(values, {(): EntryPosition(Position("campaign"), Position("campaign"))})
    return apply_overrides(tree, write_overrides(settings))


def _place(tree: Tree, inputs: ArmInputs) -> RigDescription:
    file = cast("Path", inputs.rig_file)
    return validate_tree(tree, RigDescription).placed_in(file.parent, file)


def require_calibration(inputs: ArmInputs) -> None:
    """Refuse to compute where the calibration files are not those that the campaign began with.

    Raises
    ------
    WorkersError
        Names the computer and the folder.
    """
    rig = _read_arm(inputs)[1]
    found = {} if rig is None else _hash_calibration(rig)
    for name, sha256 in inputs.calibration:
        if found.get(name) != sha256:
            what = "has another" if name in found else "does not see the"
            raise WorkersError(
                f"a worker on {platform.node()} {what} calibration file {name} of {inputs.rig_file}",
                "keep the lab folder where all workers have it under the same name, and leave it as it is meanwhile",
            )
