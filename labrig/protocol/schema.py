"""JSON Schema (draft 2020-12) of a model, as editors and error messages read it."""

import json
from typing import Any, TypeAlias

from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema
from pydantic_core.core_schema import ModelSchema

from labrig.protocol.tree import Plain

JsonSchema: TypeAlias = dict[str, Plain]

DIALECT = "https://json-schema.org/draft/2020-12/schema"


class _Schemas(GenerateJsonSchema):
    """Puts each description on one line, and leaves out the titles, which repeat the names of fields."""

    def field_title_should_be_set(self, schema: object) -> bool:  # noqa: ARG002 - pydantic's signature
        return False

    def model_schema(self, schema: ModelSchema) -> dict[str, Any]:
        made: dict[str, Any] = super().model_schema(schema)
        for field in made.get("properties", {}).values():
            if "description" in field:
                field["description"] = " ".join(field["description"].split())
        return made


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
