"""JSON Schema (draft 2020-12) of a model, as editors and error messages read it."""

import ast
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from math import inf
from pathlib import Path
from typing import Any, TypeAlias

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema
from pydantic_core.core_schema import ModelSchema

from labrig.protocol.formatting import Plain, range_words, show_key

JsonSchema: TypeAlias = dict[str, Plain]

_BOUND_WORDS = {
    "exclusiveMinimum": "above",
    "minimum": "least",
    "exclusiveMaximum": "below",
    "maximum": "most",
}
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
            return self.follow({**_as_section(options[0]), **rest, "nullable": True})
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
    def choices(self) -> tuple[str, ...]:
        """The words that are allowed, if only certain words are."""
        if "const" in self.node:
            return (str(self.node["const"]),)
        return tuple(map(str, _as_list(self.node.get("enum"))))

    @property
    def tags(self) -> Mapping[str, Plain]:
        """For a section of several kinds: kind -> reference to the schema of that kind."""
        return _as_section(_as_section(self.node.get("discriminator")).get("mapping"))

    @property
    def tag_key(self) -> str:
        """For a section of several kinds: the key that names the kind."""
        return str(_as_section(self.node.get("discriminator")).get("propertyName", ""))

    def kind(self, tag: str) -> "SchemaView":
        """Return the schema of one of `tags`."""
        return self.follow({"$ref": self.tags[tag]})

    def child(self, key: str | int) -> "SchemaView | None":
        """Return the schema of an entry, or None if the schema describes none."""
        if isinstance(key, int):
            fixed = _as_list(self.node.get("prefixItems"))
            found = fixed[key] if key < len(fixed) else self.node.get("items")
        else:
            found = _as_section(self.node.get("properties")).get(key, self.node.get("additionalProperties"))
        return self.follow(found) if isinstance(found, dict) else None

    @property
    def limits(self) -> tuple[float, float]:
        """The lowest and the highest number; either may be excluded."""
        bounds = self._bounds()
        low = bounds.get("minimum", bounds.get("exclusiveMinimum", -inf))
        return low, bounds.get("maximum", bounds.get("exclusiveMaximum", inf))

    def _bounds(self) -> dict[str, float]:
        return {
            key: float(value)
            for key, value in self.node.items()
            if key in _BOUND_WORDS and isinstance(value, int | float)
        }

    def describe(self) -> str:
        """Return the expected value, limits included, as words of a sentence."""
        words = self._describe_value()
        return f"{words} or null" if self.node.get("nullable") else words

    def _describe_value(self) -> str:
        if self.choices:
            return "one of " * (len(self.choices) > 1) + ", ".join(map(show_key, self.choices))
        if options := [*_as_list(self.node.get("anyOf")), *_as_list(self.node.get("oneOf"))]:
            return " or ".join(
                dict.fromkeys(self.follow(_as_section(option)).describe() for option in options)
            )
        describe = {
            "number": lambda: self._describe_number("a number"),
            "integer": lambda: self._describe_number("a whole number"),
            "boolean": lambda: "true or false",
            "string": self._describe_text,
            "array": self._describe_list,
            "object": self._describe_section,
        }
        return describe.get(str(self.node.get("type", "")), lambda: "another value")()

    def _describe_number(self, noun: str) -> str:
        return range_words(noun, **{_BOUND_WORDS[key]: value for key, value in self._bounds().items()})

    def _describe_text(self) -> str:
        least, most = self.node.get("minLength", 0), self.node.get("maxLength")
        if most is None:
            return "text"
        return f"text of {least} to {most} characters" if least else f"text of at most {most} characters"

    def _describe_list(self) -> str:
        entry = self.child(0)
        return f"a list{self._describe_count()}" + (f", each {entry.describe()}" if entry else "")

    def _describe_count(self) -> str:
        least, most = self.node.get("minItems", 0), self.node.get("maxItems")
        if most is None:
            return f" of at least {least} entries" if least else ""
        return f" of {most} values" if least == most else f" of {least} to {most} entries"

    def _describe_section(self) -> str:
        return f"a section with {', '.join(self.keys)}" if self.keys else "a section (keys and values)"


def _as_section(value: Plain) -> dict[str, Plain]:
    return value if isinstance(value, dict) else {}


def _as_list(value: Plain) -> list[Plain]:
    return value if isinstance(value, list) else []
