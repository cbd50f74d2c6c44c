"""JSON Schema (draft 2020-12) of a model, as editors and error messages read it."""

import ast
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeAlias

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema
from pydantic_core.core_schema import ModelSchema

from labrig.protocol.formatting import KeyPath, Plain

JsonSchema: TypeAlias = dict[str, Plain]

DIALECT = "https://json-schema.org/draft/2020-12/schema"


class _Schemas(GenerateJsonSchema):
    """Describes fields by the docstrings below them, and leaves out the titles, which repeat their names."""

    def field_title_should_be_set(self, schema: object) -> bool:  # noqa: ARG002 - pydantic's signature
        return False

    def model_schema(self, schema: ModelSchema) -> dict[str, Any]:
        made: dict[str, Any] = super().model_schema(schema)
        for key, field in made.get("properties", {}).items():
            described = (_read_docstrings(cls).get(key) for cls in schema["cls"].__mro__)
            text = next(filter(None, described), None)
            if text is not None:
                field.setdefault("description", text)
        return made


@cache
def _read_docstrings(cls: type) -> Mapping[str, str]:
    """Return the docstring below each field of a class. pydantic would read them at each start, for nothing mostly."""
    file = getattr(sys.modules.get(cls.__module__), "__file__", None)
    body = _read_classes(Path(file)).get(cls.__qualname__, ()) if file else ()
    return {
        field.target.id: " ".join(text.value.value.split())
        for field, text in pairwise(body)
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
        if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant)
        if isinstance(text.value.value, str)
    }


@cache
def _read_classes(file: Path) -> Mapping[str, Sequence[ast.stmt]]:
    tree = ast.parse(file.read_bytes()) if file.suffix == ".py" else ast.Module([], [])
    return {node.name: node.body for node in tree.body if isinstance(node, ast.ClassDef)}


def model_schema(model: Any, title: str) -> JsonSchema:
    """Return the JSON Schema of `model`, a model class or an annotated union of them, which has no type of its own."""
    made = TypeAdapter(model).json_schema(schema_generator=_Schemas)
    return {
        "$schema": DIALECT,
        "title": title,
        **{key: value for key, value in made.items() if key != "title"},
    }


def schema_text(schema: JsonSchema) -> str:
    """Return `schema` as the text of a file: indented, in declared order, the same on every machine."""
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


@dataclass(frozen=True)
class SchemaView:
    """A part of a JSON Schema, with references resolved, for error messages.

    Parameters
    ----------
    node : mapping
        The schema of the part.
    definitions : mapping
        The `$defs` of the whole schema.
    """

    node: Mapping[str, Plain]
    definitions: Mapping[str, Plain]

    @classmethod
    def of(cls, schema: JsonSchema) -> "SchemaView":
        """Return the view of a whole schema."""
        return cls(schema, _as_section(schema.get("$defs"))).follow(schema)

    def follow(self, node: Mapping[str, Plain]) -> "SchemaView":
        """Return the view of `node`, with its reference and its `or null` resolved."""
        if "$ref" in node:
            target = _as_section(self.definitions[str(node["$ref"]).rsplit("/", 1)[1]])
            node = {**target, **{key: value for key, value in node.items() if key != "$ref"}}
        options = [option for option in _as_list(node.get("anyOf")) if option != {"type": "null"}]
        if len(options) == 1:
            rest = {key: value for key, value in node.items() if key != "anyOf"}
            return self.follow({**_as_section(options[0]), **rest})
        return SchemaView(node, self.definitions)

    @property
    def description(self) -> str:
        """What the field is, with its unit; empty if the model has no description."""
        return str(self.node.get("description", ""))

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys of a section."""
        return tuple(_as_section(self.node.get("properties")))

    @property
    def tags(self) -> Mapping[str, Plain]:
        """For a section of several kinds: kind -> reference to the schema of that kind."""
        return _as_section(_as_section(self.node.get("discriminator")).get("mapping"))

    @property
    def tag_key(self) -> str:
        """For a section of several kinds: the key that names the kind."""
        return str(_as_section(self.node.get("discriminator")).get("propertyName", ""))

    def find(
        self, path: KeyPath, value_at: Callable[[KeyPath], Plain], named: Sequence[str] = ()
    ) -> "SchemaView | None":
        """Return the schema of the entry at a path; None without one.

        The kind of a section on the way is the one that its values name, or one of those that are `named` otherwise.
        """
        view: SchemaView | None = self
        for end in range(len(path) + 1):
            if view is not None and view.tags:
                told = (str(value_at((*path[:end], view.tag_key))), *named)
                kind = next((view.tags[tag] for tag in told if tag in view.tags), None)
                view = view if kind is None else view.follow({"$ref": kind})
            if view is not None and end < len(path):
                view = view.child(path[end])
        return view

    def child(self, key: str | int) -> "SchemaView | None":
        """Return the schema of an entry, or None if the schema describes none."""
        if isinstance(key, int):
            fixed = _as_list(self.node.get("prefixItems"))
            found = fixed[key] if key < len(fixed) else self.node.get("items")
        else:
            found = _as_section(self.node.get("properties")).get(key, self.node.get("additionalProperties"))
        return self.follow(found) if isinstance(found, dict) else None


def _as_section(value: Plain) -> dict[str, Plain]:
    return value if isinstance(value, dict) else {}


def _as_list(value: Plain) -> list[Plain]:
    return value if isinstance(value, list) else []
