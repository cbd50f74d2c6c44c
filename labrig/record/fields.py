"""What of a run can be asked for in the catalogue: each value of its manifest, protocol, newest result and notes."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path

from labrig.errors import FileFormatError, RecordError
from labrig.protocol.yaml_tree import yaml_values
from labrig.record.annotations import Annotations
from labrig.record.condition import Value
from labrig.record.layout import PROTOCOL, inside
from labrig.record.results import latest_result

Leaves = dict[str, list[Value]]

# Hashes and lists of every picture tell runs apart, and say nothing that anybody would ask for.
_LEFT_OUT = frozenset(
    {
        "schema_version",
        "crc32",
        "hashes",
        "command_line",
        "drive_settings",
        "settings_written",
        "packages",
        "inputs",
        "created",
    }
)
_LEFT_OUT_OF_RESULTS = frozenset({*_LEFT_OUT, "provenance", "measurements", "cells", "corners"})


def manifest_fields(manifest: Mapping[str, object]) -> Leaves:
    """Return the values of a manifest by dotted path, and `duration_s`."""
    fields = leaves(manifest, "", _LEFT_OUT)
    duration_s = _duration_s(manifest)
    return fields if duration_s is None else {**fields, "duration_s": [duration_s]}


ANNOTATION_FIELDS = frozenset({"tag", "verdict", "verdict_reason", "note"})
"""What may be asked for also where nobody has said anything yet."""


def annotation_fields(said: Annotations) -> Leaves:
    """Return tags, verdict and notes; what nobody has said has no value, so that no other field answers for it."""
    return {
        "tag": list(said.tags),
        "verdict": [] if said.verdict is None else [said.verdict],
        "verdict_reason": [] if said.verdict_reason is None else [said.verdict_reason],
        "note": [note.text for note in said.notes],
    }


def file_fields(run: Path) -> Leaves:
    """Return the values of protocol.yaml and of the newest result; of a file that cannot be read none."""
    fields: Leaves = {}
    with suppress(FileFormatError, RecordError):
        fields |= leaves(yaml_values(inside(run, PROTOCOL)), "protocol.", _LEFT_OUT)
    with suppress(RecordError):
        fields |= leaves(latest_result(run) or {}, "result.", _LEFT_OUT_OF_RESULTS)
    return fields


def leaves(values: Mapping[str, object], prefix: str, left_out: frozenset[str]) -> Leaves:
    """Return the scalars of nested values by dotted path; the items of a list share the path of the list."""
    found: Leaves = {}
    for path, value in _walked(values, prefix.rstrip("."), left_out):
        held = found.setdefault(path, [])
        if value not in held:
            held.append(value)
    return found


def _walked(value: object, path: str, left_out: frozenset[str]) -> Iterator[tuple[str, Value]]:
    if isinstance(value, Mapping):
        for key, item in value.items():
            if key not in left_out:
                yield from _walked(item, f"{path}.{key}" if path else str(key), left_out)
    elif isinstance(value, Sequence) and not isinstance(value, str):
        for item in value:
            yield from _walked(item, path, left_out)
    elif value is None or isinstance(value, str | int | float):
        yield path, value


def _duration_s(manifest: Mapping[str, object]) -> float | None:
    started, ended = manifest.get("started"), manifest.get("ended")
    try:
        return (datetime.fromisoformat(str(ended)) - datetime.fromisoformat(str(started))).total_seconds()
    except (ValueError, TypeError):
        return None
