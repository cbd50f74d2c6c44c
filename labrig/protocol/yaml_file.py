"""YAML file -> frozen model, and back; the one way in and out for protocols, rig files and records."""

import difflib
import json
from codecs import BOM_UTF8
from collections.abc import Mapping, Sequence
from io import StringIO
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from pydantic import ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.nodes import ScalarNode
from ruamel.yaml.representer import SafeRepresenter

from labrig.errors import FileFormatError
from labrig.protocol.explain import explained
from labrig.protocol.model import Model
from labrig.protocol.overrides import overridden
from labrig.protocol.schema import SchemaView, model_schema
from labrig.protocol.tree import (
    EntryPosition,
    InputFault,
    Position,
    Tree,
    file_format_error,
    half_characters,
)
from labrig.protocol.words import Plain
from labrig.protocol.yaml_text import read_tree

_SUFFIXES = frozenset({".yaml", ".yml", ".json"})
MAX_BYTES = 256 * 1024  # a hundred times a long protocol; ruamel.yaml reads about 150 kB a second

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
        What the file must hold.
    overrides : sequence of str
        `dotted.key=value` each, put over the file's values.
    others : mapping of str to (str, str)
        As `require_kind` has them.

    Raises
    ------
    FileFormatError
        With every problem of the file and of the overrides.
    """
    tree = tree_of_file(Path(path))
    require_kind(tree, others)
    return model_of_tree(overridden(tree, overrides), model)


def yaml_values(path: Path | str) -> dict[str, Plain]:
    """Return what a YAML file says, of whatever kind it is, as JSON would hold it.

    Raises
    ------
    FileFormatError
        When it is no YAML, or holds no mapping.
    """
    tree = tree_of_file(Path(path))
    if tree.faults:
        raise file_format_error(list(tree.faults))
    return tree.section(())


def model_of_values(values: Mapping[str, object], source: str, model: type[AnyModel]) -> AnyModel:
    """Return the `model` of values that stand in no file, such as options. Raises as `load_yaml_model`."""
    position = Position(source)
    plain = json.loads(json.dumps(values, default=str))
    return model_of_tree(Tree(plain, {(): EntryPosition(position, position)}), model)


def dump_yaml(model: Model) -> str:
    """Return `model` as YAML, defaults written out; loading it gives an equal model."""
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
    """Writes text with line breaks or controls in double quotes, the one style that keeps all of them."""

    def represent_text(self, text: str) -> ScalarNode:
        """Return the node of a text."""
        style = None if text.isprintable() else '"'
        return self.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Representer.add_representer(str, _Representer.represent_text)


def tree_of_file(path: Path) -> Tree:
    """Return the mapping that a file holds, with places. Raises `FileFormatError`."""
    content = _read_bytes(path).removeprefix(BOM_UTF8)
    try:
        return read_tree(_decoded(content, str(path)), str(path))
    except FileFormatError as error:
        if path.suffix in _SUFFIXES:
            raise
        raise _unreadable(path, "this is no YAML file", _nearby_hint(path.parent / "x.yaml")) from error


def require_kind(tree: Tree, others: Mapping[str, tuple[str, str]]) -> None:
    """Refuse a file of another kind in one sentence, instead of every key that it has not.

    Parameters
    ----------
    others : mapping of str to (str, str)
        A key that only files of another kind have -> what such a file is, and what to do.

    Raises
    ------
    FileFormatError
    """
    for key, (message, hint) in others.items():
        if tree.holds((key,)):
            raise file_format_error([InputFault(tree.at((key,)).key, (key,), message, hint)])


def model_of_tree(tree: Tree, model: type[AnyModel]) -> AnyModel:
    """Return the validated model of a tree. Raises `FileFormatError` with the faults of both."""
    if halves := tuple(half_characters(tree)):
        raise file_format_error([*tree.faults, *halves])
    try:
        # Through JSON: strict there reads a list as a tuple and 40 as 40.0, and converts nothing else.
        made = model.model_validate_json(json.dumps(tree.values))
    except ValidationError as error:
        view = SchemaView.of(model_schema(model, ""))
        raise file_format_error([*tree.faults, *explained(error, tree, view)]) from error
    if tree.faults:
        raise file_format_error(tree.faults)
    return made


def _read_bytes(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except FileNotFoundError as error:
        raise _unreadable(path, "there is no such file", _nearby_hint(path)) from error
    except IsADirectoryError as error:
        raise _unreadable(path, "this is a folder, expected a YAML file", _nearby_hint(path / "x")) from error
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = getattr(error, "strerror", None) or str(error)
        raise _unreadable(path, f"cannot be read: {reason}", "check the name and the permissions") from error
    if len(content) > MAX_BYTES:
        message = f"larger than {MAX_BYTES // 1024} kB, expected a file written by hand"
        raise _unreadable(path, message, "is this the right file?")
    return content


def _decoded(content: bytes, source: str) -> str:
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        before = content[: error.start].decode("utf-8")
        position = Position(source, before.count("\n") + 1, len(before) - before.rfind("\n"))
        message = f"the byte 0x{content[error.start]:02x} is not UTF-8, expected text in UTF-8"
        raise file_format_error(
            [InputFault(position, (), message, "save the file as UTF-8 in your editor")]
        ) from error


def _unreadable(path: Path, message: str, hint: str) -> FileFormatError:
    return file_format_error([InputFault(Position(str(path)), (), message, hint)])


def _nearby_hint(path: Path) -> str:
    """Return the YAML files beside `path`, or the one that was probably meant."""
    if not path.parent.is_dir():
        return f"the folder {path.parent} does not exist"
    names = sorted(each.name for each in path.parent.iterdir() if each.suffix in _SUFFIXES)
    if meant := difflib.get_close_matches(path.name, names, n=1):
        return f"did you mean {path.parent / meant[0]}?"
    return f"YAML files there: {', '.join(names[:10])}" if names else f"{path.parent} holds no YAML file"
