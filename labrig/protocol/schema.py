"""JSON Schema (draft 2020-12) of a model, as editors and error messages read it."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema

from labrig.protocol.words import range_words, show_key

JsonSchema: TypeAlias = dict[str, Any]

DIALECT = "https://json-schema.org/draft/2020-12/schema"


class _Untitled(GenerateJsonSchema):
    """Leaves out the titles that pydantic makes from field names: the names say it."""

    def field_title_should_be_set(self, schema: Any) -> bool:  # noqa: ARG002 - asked for each field
        return False


def model_schema(model: Any, title: str) -> JsonSchema:
    """Return the JSON Schema of `model` (a model class, or an annotated union of them) under `title`."""
    made = TypeAdapter(model).json_schema(schema_generator=_Untitled)
    return {"$schema": DIALECT, "title": title, **{key: each for key, each in made.items() if key != "title"}}


def schema_text(schema: JsonSchema) -> str:
    """Return `schema` as the text of a file: indented, in declared order, the same on every machine."""
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


@dataclass(frozen=True)
class SchemaView:
    """One place of a JSON Schema, with references followed, for error messages.

    Parameters
    ----------
    node : mapping
        The schema of the place.
    definitions : mapping
        The `$defs` of the whole schema.
    """

    node: Mapping[str, Any]
    definitions: Mapping[str, Any]

    @classmethod
    def of(cls, schema: JsonSchema) -> "SchemaView":
        """Return the top of a whole schema."""
        return cls(schema, schema.get("$defs", {})).followed(schema)

    def followed(self, node: Mapping[str, Any]) -> "SchemaView":
        """Return the view of `node`, its reference and its `or null` resolved."""
        if "$ref" in node:
            target = self.definitions[node["$ref"].rsplit("/", 1)[1]]
            node = {**target, **{key: value for key, value in node.items() if key != "$ref"}}
        options = [each for each in node.get("anyOf", ()) if each != {"type": "null"}]
        if len(options) == 1:
            rest = {key: value for key, value in node.items() if key != "anyOf"}
            return self.followed({**options[0], **rest, "nullable": True})
        return SchemaView(node, self.definitions)

    @property
    def description(self) -> str:
        """What the field is, with its unit; empty where nobody wrote it."""
        return str(self.node.get("description", ""))

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys of a section."""
        return tuple(self.node.get("properties", {}))

    @property
    def choices(self) -> tuple[str, ...]:
        """The words that may stand here, where only some may."""
        if "const" in self.node:
            return (str(self.node["const"]),)
        return tuple(map(str, self.node.get("enum", ())))

    @property
    def tags(self) -> Mapping[str, str]:
        """For a section of several kinds: kind -> reference to the schema of that kind."""
        return dict(self.node.get("discriminator", {}).get("mapping", {}))

    @property
    def tag_key(self) -> str:
        """For a section of several kinds: the key that names the kind."""
        return str(self.node.get("discriminator", {}).get("propertyName", ""))

    def kind(self, tag: str) -> "SchemaView":
        """Return the schema of one of `tags`."""
        return self.followed({"$ref": self.tags[tag]})

    def child(self, key: str | int) -> "SchemaView | None":
        """Return the schema of an entry, or None where none is described."""
        if isinstance(key, int):
            fixed = self.node.get("prefixItems", ())
            found = fixed[key] if key < len(fixed) else self.node.get("items")
        else:
            found = self.node.get("properties", {}).get(key, self.node.get("additionalProperties"))
        return self.followed(found) if isinstance(found, Mapping) else None

    @property
    def limits(self) -> tuple[float, float]:
        """The lowest and highest number, whether or not they are included."""
        low = self.node.get("minimum", self.node.get("exclusiveMinimum", float("-inf")))
        high = self.node.get("maximum", self.node.get("exclusiveMaximum", float("inf")))
        return float(low), float(high)

    def words(self) -> str:
        """Return what is expected here, limits included, as words of a sentence."""
        said = self._own_words()
        return f"{said} or null" if self.node.get("nullable") else said

    def _own_words(self) -> str:
        if self.choices:
            return "one of " * (len(self.choices) > 1) + ", ".join(map(show_key, self.choices))
        if options := [*self.node.get("anyOf", ()), *self.node.get("oneOf", ())]:
            return " or ".join(dict.fromkeys(self.followed(option).words() for option in options))
        describe = {
            "number": lambda: self._number_words("a number"),
            "integer": lambda: self._number_words("a whole number"),
            "boolean": lambda: "true or false",
            "string": self._text_words,
            "array": self._list_words,
            "object": self._section_words,
        }
        return describe.get(self.node.get("type", ""), lambda: "another value")()

    def _number_words(self, noun: str) -> str:
        names = {
            "exclusiveMinimum": "above",
            "minimum": "least",
            "exclusiveMaximum": "below",
            "maximum": "most",
        }
        return range_words(noun, **{word: self.node[key] for key, word in names.items() if key in self.node})

    def _text_words(self) -> str:
        least, most = self.node.get("minLength", 0), self.node.get("maxLength")
        if most is None:
            return "text"
        return f"text of {least} to {most} characters" if least else f"text of at most {most} characters"

    def _list_words(self) -> str:
        each = self.child(0)
        return f"a list{self._count_words()}" + (f", each {each.words()}" if each else "")

    def _count_words(self) -> str:
        least, most = self.node.get("minItems", 0), self.node.get("maxItems")
        if most is None:
            return f" of at least {least} entries" if least else ""
        return f" of {most} values" if least == most else f" of {least} to {most} entries"

    def _section_words(self) -> str:
        return f"a section with {', '.join(self.keys)}" if self.keys else "a section (keys and values)"
