"""YAML file -> frozen model, and back; the only reader and writer of protocols and rig files."""

import json
from collections.abc import Mapping, Sequence
from io import StringIO
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from pydantic import ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.nodes import ScalarNode, SequenceNode
from ruamel.yaml.representer import SafeRepresenter

from labrig.protocol.explain import explain_errors
from labrig.protocol.model import Model
from labrig.protocol.overrides import apply_overrides
from labrig.protocol.schema import SchemaView, model_schema
from labrig.protocol.tree import EntryPosition, Position, Tree, file_format_error
from labrig.protocol.yaml_tree import load_tree, require_kind

AnyModel = TypeVar("AnyModel", bound=Model)


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


def validate_values(
    values: object, source: str, model: type[AnyModel], overrides: Sequence[str] = ()
) -> AnyModel:
    """Return the `model` of values that come from no file, such as options. Raises as `load_yaml_model`."""
    position = Position(source)
    tree = Tree(json.loads(json.dumps(values, default=str)), {(): EntryPosition(position, position)})
    return validate_tree(apply_overrides(tree, overrides), model)


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
    """Writes points on one line, and text with line breaks or control characters in double quotes, which keep them."""

    def represent_points(self, values: list[object]) -> SequenceNode:
        """Return the node of a list; one of points, such as a path, is written without a line for each number."""
        are_points = bool(values) and all(isinstance(point, list) and _are_numbers(point) for point in values)
        return self.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=are_points or None)

    def represent_text(self, text: str) -> ScalarNode:
        """Return the node of a text."""
        style = None if text.isprintable() else '"'
        return self.represent_scalar("tag:yaml.org,2002:str", text, style=style)


def _are_numbers(values: list[object]) -> bool:
    return all(isinstance(value, int | float) for value in values)


_Representer.add_representer(list, _Representer.represent_points)
_Representer.add_representer(str, _Representer.represent_text)


def validate_tree(tree: Tree, model: type[AnyModel]) -> AnyModel:
    """Return the validated model of a tree. Raises `FileFormatError` with all faults of the tree and the model."""
    try:
        # From JSON, strict mode reads a list as a tuple and 40 as 40.0, and converts nothing else.
        made = model.model_validate_json(json.dumps(tree.values))
    except ValidationError as error:
        view = SchemaView.of(model_schema(model, ""))
        raise file_format_error([*tree.faults, *explain_errors(error, tree, view)]) from error
    if tree.faults:
        raise file_format_error(tree.faults)
    return made
