"""YAML file -> frozen model, and back; the only reader and writer of protocols and rig files."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import reduce
from io import StringIO
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from pydantic import ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.nodes import ScalarNode
from ruamel.yaml.representer import SafeRepresenter

from labrig.errors import FileFormatError, InputError
from labrig.protocol.explain import explain_errors
from labrig.protocol.model import Model
from labrig.protocol.schema import model_schema
from labrig.protocol.tree import InputFault, Plain, Position, Tree, file_format_error, show
from labrig.protocol.yaml_text import MAX_DEPTH, compose, load_tree, resolve_scalar

AnyModel = TypeVar("AnyModel", bound=Model)

SET = Position("--set")


def load_yaml_model(
    path: Path | str,
    model: type[AnyModel],
    overrides: Sequence[str] = (),
    others: Mapping[str, tuple[str, str]] = MappingProxyType({}),
) -> AnyModel:
    """Return the `model` that a YAML file describes.

    Parameters
    ----------
    path : Path or str
        The file; UTF-8, YAML 1.2, one mapping.
    model : type of Model
        The model that the file must fit.
    overrides : sequence of str
        `dotted.key=value` each; they replace values of the file.
    others : mapping of str to (str, str)
        As in `require_kind`.

    Raises
    ------
    FileFormatError
        With every problem of the file and of the overrides.
    """
    tree = load_tree(Path(path))
    require_kind(tree, others)
    return validate_tree(apply_overrides(tree, overrides), model)


def require_kind(tree: Tree, others: Mapping[str, tuple[str, str]]) -> None:
    """Refuse a file of another kind in one sentence, instead of naming every missing key.

    Parameters
    ----------
    others : mapping of str to (str, str)
        Key that only files of another kind have -> a message that names this kind, and a hint.

    Raises
    ------
    FileFormatError
    """
    for key, (message, hint) in others.items():
        if tree.holds((key,)):
            raise file_format_error([tree.fault((key,), message, hint)])


def validate_values(
    values: object, source: str, model: type[AnyModel], overrides: Sequence[str] = ()
) -> AnyModel:
    """Return the `model` of values that come from no file, such as options. Raises as `load_yaml_model`."""
    tree = Tree(json.loads(json.dumps(values, default=str)), {(): Position(source)})
    return validate_tree(apply_overrides(tree, overrides), model)


def validate_tree(tree: Tree, model: type[AnyModel]) -> AnyModel:
    """Return the validated model of a tree. Raises `FileFormatError` with all faults of the tree and the model."""
    try:
        # From JSON, strict mode reads a list as a tuple and 40 as 40.0, and converts nothing else.
        made = model.model_validate_json(json.dumps(tree.values))
    except ValidationError as error:
        faults = explain_errors(error, tree, model_schema(model, ""))
        raise file_format_error([*tree.faults, *faults]) from error
    if tree.faults:
        raise file_format_error(tree.faults)
    return made


def apply_overrides(tree: Tree, overrides: Sequence[str]) -> Tree:
    """Return `tree` with each `dotted.key=value` put in; a later override replaces an earlier one.

    A value is a YAML scalar, or any YAML if it starts with a bracket, a brace or a quote. An index names the entry of a
    list: `specimens.0.name=A`. Unknown keys are found when the model is validated.
    """
    return reduce(_apply_override, overrides, tree)


def _apply_override(tree: Tree, text: str) -> Tree:
    dotted, equals, raw = text.partition("=")
    path = tuple(dotted.strip().split("."))
    if not equals or not all(path) or len(path) > MAX_DEPTH:
        hint = "for example --set insertion.length_mm=30"
        fault = InputFault(SET, (), f"{show(text)} is not an override, expected dotted.key=value", hint)
        return replace(tree, faults=(*tree.faults, fault))
    try:
        return tree.put(path, _read_value(raw.strip()), SET)
    except FileFormatError as error:
        shown = show(raw.strip())
        faults = [InputFault(SET, path, f"{fault.message}: {shown}", fault.hint) for fault in error.problems]
    except InputError as error:
        faults = [InputFault(SET, path, error.message)]
    return replace(tree, faults=(*tree.faults, *faults))


def _read_value(text: str) -> Plain:
    if text[:1] not in {"[", "{", '"', "'"}:
        return resolve_scalar(text)
    composed = compose(text, str(SET))
    if composed.faults:
        raise file_format_error(composed.faults)
    return composed.values


def dump_yaml(model: Model) -> str:
    """Return `model` as YAML with all defaults; loading it gives an equal model."""
    yaml: Any = YAML(typ="safe", pure=True)  # its attributes are typed by their defaults, None
    yaml.Representer = _Representer
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # the declared order reads better than the alphabet
    yaml.allow_unicode = True
    yaml.width = 110
    stream = StringIO()
    yaml.dump(model.model_dump(mode="json"), stream)
    return stream.getvalue()


class _Representer(SafeRepresenter):
    """Writes text with line breaks or control characters in double quotes, which keep them."""

    def represent_text(self, text: str) -> ScalarNode:
        """Return the node of a text."""
        return self.represent_scalar("tag:yaml.org,2002:str", text, style=None if text.isprintable() else '"')


_Representer.add_representer(str, _Representer.represent_text)
