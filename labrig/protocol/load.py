"""Protocol file -> the model of the experiment that it names."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, TypeAlias

from pydantic import Field

from labrig.protocol.designed_needle import IN_PROTOCOL, IN_SCENARIO, with_design
from labrig.protocol.explain import choice_fault
from labrig.protocol.insertion import InsertionProtocol, RollZeroProtocol
from labrig.protocol.overrides import overridden
from labrig.protocol.protocols import (
    CameraCalibrationProtocol,
    DesignProtocol,
    ImportProtocol,
    Needle,
    SteerabilityProtocol,
)
from labrig.protocol.scenario import Scenario
from labrig.protocol.schema import JsonSchema, model_schema
from labrig.protocol.tree import Position, Tree, file_format_error
from labrig.protocol.yaml_file import model_of_tree
from labrig.protocol.yaml_text import read_tree
from labrig.protocol.yaml_tree import require_kind, tree_of_file

AnyProtocol: TypeAlias = (
    SteerabilityProtocol
    | InsertionProtocol
    | RollZeroProtocol
    | CameraCalibrationProtocol
    | ImportProtocol
    | DesignProtocol
)

_MODELS: dict[str, type[AnyProtocol]] = {
    "steerability": SteerabilityProtocol,
    "insertion": InsertionProtocol,
    "roll-zero": RollZeroProtocol,
    "camera-calibration": CameraCalibrationProtocol,
    "import": ImportProtocol,
    "design": DesignProtocol,
}


_OTHER_KINDS = {
    "axes": (
        "this is a rig file, expected a protocol",
        "labrig run protocols/steerability.yaml --rig THIS_FILE",
    )
}


def load_protocol(path: Path | str, overrides: Sequence[str] = (), seed: int | None = None) -> AnyProtocol:
    """Return the protocol in a file; the numbers of a design file that it names are put into it.

    Parameters
    ----------
    path : Path or str
        The YAML file; its `experiment:` names the model.
    overrides : sequence of str
        `dotted.key=value` each, put over the file's values.
    seed : int, optional
        Put over the file's seed and over any override.

    Raises
    ------
    FileFormatError
        With every problem of the file and of the overrides.
    """
    tree = overridden(tree_of_file(Path(path)), overrides)
    if seed is not None:
        tree = tree.put(("seed",), seed, Position("--seed"))
    return _protocol_of(tree, Path(path).parent)


def parse_protocol(text: str, source: str) -> AnyProtocol:
    """Return the protocol in a text; `source` names it in messages. Raises as `load_protocol`."""
    return _protocol_of(read_tree(text, source), None)


def load_scenario(path: Path | str) -> Scenario:
    """Return the scenario in a file, YAML or JSON; the numbers of a design file that it names are put into it.

    Raises
    ------
    FileFormatError
        With every problem of the file.
    """
    return model_of_tree(with_design(tree_of_file(Path(path)), Path(path).parent, IN_SCENARIO), Scenario)


def protocol_schema() -> JsonSchema:
    """Return the JSON Schema (draft 2020-12) of a protocol file, for editors."""
    return model_schema(Annotated[AnyProtocol, Field(discriminator="experiment")], "labrig protocol")


def _protocol_of(tree: Tree, folder: Path | None) -> AnyProtocol:
    if not tree.holds(("experiment",)):
        require_kind(tree, _OTHER_KINDS)
    model = _MODELS.get(str(tree.value(("experiment",))))
    if model is None:
        raise file_format_error([*tree.faults, choice_fault(tree, ("experiment",), tuple(_MODELS))])
    takes_design = "needle" in model.model_fields and model.model_fields["needle"].annotation is Needle
    return model_of_tree(with_design(tree, folder, IN_PROTOCOL) if takes_design else tree, model)
