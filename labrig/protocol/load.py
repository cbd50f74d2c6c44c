"""Protocol file -> the model of the experiment that it names."""

from collections.abc import Mapping, Sequence
from functools import reduce
from operator import or_
from pathlib import Path
from typing import Annotated, Any, TypeAlias

from pydantic import Field

from labrig.protocol.explain import choice_fault
from labrig.protocol.named_files import fill_in_files
from labrig.protocol.schema import JsonSchema, model_schema
from labrig.protocol.sections import ExperimentProtocol
from labrig.protocol.tree import Position, Tree, file_format_error
from labrig.protocol.yaml_file import apply_overrides, require_kind, validate_tree
from labrig.protocol.yaml_text import load_tree

Models: TypeAlias = Mapping[str, type[ExperimentProtocol]]
"""The model of each experiment's protocol, by the name that a protocol file gives as `experiment:`."""

_OTHER_KINDS = {
    "axes": (
        "this is a rig file, expected a protocol",
        "labrig run protocols/steerability.yaml --rig THIS_FILE",
    ),
    "campaign": ("this is a campaign file, expected a protocol", "labrig campaign THIS_FILE"),
}


def load_protocol(
    path: Path | str, models: Models, overrides: Sequence[str] = (), seed: int | None = None
) -> ExperimentProtocol:
    """Return the protocol in a file, with what the design file and the specimen files say that it may name.

    Parameters
    ----------
    path : Path or str
        The YAML file; its `experiment:` names the model.
    models : Mapping
        The models of the installed experiments.
    overrides : sequence of str
        `dotted.key=value` each; they replace values of the file.
    seed : int, optional
        Replaces the seed of the file and of any override.

    Raises
    ------
    FileFormatError
        With every problem of the file and of the overrides.
    """
    tree = apply_overrides(load_tree(Path(path)), overrides)
    if seed is not None:
        tree = tree.put(("seed",), seed, Position("--seed"))
    return validate_tree(fill_in_files(tree, Path(path).parent), _find_model(tree, models))


def load_recorded_protocol(
    path: Path | str, models: Models, overrides: Sequence[str] = ()
) -> ExperimentProtocol:
    """Return the protocol of a record, which needs no file outside of it.

    Parameters
    ----------
    path : Path or str
        The file, with every key.
    models : Mapping
        As in `load_protocol`.
    overrides : sequence of str
        As in `load_protocol`.

    Raises
    ------
    FileFormatError
        With every problem of the file and of the overrides.
    """
    tree = load_tree(Path(path))
    return validate_tree(apply_overrides(tree, overrides), _find_model(tree, models))


def _find_model(tree: Tree, models: Models) -> type[ExperimentProtocol]:
    if not tree.holds(("experiment",)):
        require_kind(tree, _OTHER_KINDS)
    model = models.get(str(tree.value(("experiment",))))
    if model is None:
        keys = {name: models[name].model_fields.keys() for name in models}
        best = max(keys, key=lambda name: (len(keys[name] & tree.section(()).keys()), -len(keys[name])))
        raise file_format_error([*tree.faults, choice_fault(tree, ("experiment",), tuple(models), best)])
    return model


def protocol_schema(models: Models) -> JsonSchema:
    """Return the JSON Schema (draft 2020-12) of a protocol file, for editors."""
    union: Any = reduce(or_, models.values())
    return model_schema(Annotated[union, Field(discriminator="experiment")], "labrig protocol")
