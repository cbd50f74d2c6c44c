"""The JSON Schema that editors and error messages read."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.protocol.load import protocol_schema
from labrig.protocol.schema import schema_text
from labrig.protocol.specimen_file import specimen_schema

COMMITTED = Path(__file__).parents[2] / "protocols" / "protocol.schema.json"

SUFFIX_UNITS = {
    "_deg_per_root_mm": "[deg / mm^0.5]", "_per_mm": "millimetre", "_mm_s": "[mm/s]", "px_per_mm": "[px/mm]",
    "_mm": "[mm]", "_rad": "[rad]", "_px": "[px]",
}  # fmt: skip


def every_property(schema: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield each field of each section with its dotted name, references followed."""
    for name, section in schema["$defs"].items():
        for key, field in section.get("properties", {}).items():
            target = schema["$defs"].get(field.get("$ref", "").rsplit("/", 1)[-1], {})
            yield f"{name}.{key}", {**target, **field}


def test_the_committed_schema_is_current():
    """Editors check against what the code accepts."""
    assert COMMITTED.read_text(encoding="utf-8") == schema_text(protocol_schema(PROTOCOL_MODELS)), (
        "the committed schema is out of date; run: labrig init ."
    )
    specimens = COMMITTED.parents[1] / "data" / "specimens" / "specimen.schema.json"
    assert specimens.read_text(encoding="utf-8") == schema_text(specimen_schema())


def test_the_schema_is_draft_2020_12_with_one_branch_for_each_experiment():
    """Each branch fixes `experiment` to another word, so that a file matches at most one."""
    schema: Any = protocol_schema(PROTOCOL_MODELS)
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    branches = [schema["$defs"][branch["$ref"].rsplit("/", 1)[1]] for branch in schema["oneOf"]]
    words = [branch["properties"]["experiment"]["const"] for branch in branches]
    assert words == ["camera-calibration", "design", "import", "insertion", "roll-zero", "steerability"]
    assert all("experiment" in branch["required"] for branch in branches)


def test_every_reference_resolves_and_every_section_is_closed():
    """An editor can follow the schema and marks unknown keys."""
    schema: Any = protocol_schema(PROTOCOL_MODELS)
    assert set(re.findall(r'"\$ref": "#/\$defs/(\w+)"', json.dumps(schema))) == set(schema["$defs"])
    assert all(section["additionalProperties"] is False for section in schema["$defs"].values())


def test_every_field_is_described_with_the_unit_that_its_name_ends_with():
    """What an editor shows beside a key says what it is and in which unit."""
    for name, field in every_property(protocol_schema(PROTOCOL_MODELS)):
        assert re.match("[A-Z].*", field.get("description", "")), name
        unit = next((unit for suffix, unit in SUFFIX_UNITS.items() if name.endswith(suffix)), "")
        assert unit in field["description"], name
