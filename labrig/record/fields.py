"""The searchable fields of a run: the values of its manifest, protocol, newest result and annotations."""

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime
from functools import lru_cache
from pathlib import Path

from labrig.errors import FileFormatError, RecordError
from labrig.input_file import read_file
from labrig.protocol.yaml_tree import MAX_BYTES, load_yaml_values, parse_yaml_values
from labrig.record.annotations import Annotations, read_annotations
from labrig.record.catalogue import RunSummary
from labrig.record.json_lines import plain_text
from labrig.record.layout import PROTOCOL, inside
from labrig.record.manifest import is_newer, read_document
from labrig.record.results import latest_result
from labrig.record.run_index import Fields, Value
from labrig.record.seal import Seal, read_seal

_SECTION = re.compile(r"^(?=[A-Za-z_]\w*:\s)", re.MULTILINE)

Leaves = dict[str, list[Value]]

# Hashes, lists of all pictures and old tracks differ between runs, but nobody searches for them.
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
        "tracks",
    }
)
_LONG_LISTS = ("measurements", "cells", "corners", "maps")
_LEFT_OUT_OF_RESULTS = frozenset({*_LEFT_OUT, "provenance", *_LONG_LISTS})


def read_fields(summary: RunSummary) -> Fields:
    """Return all fields of a run; of a damaged run, or of a newer labrig's, those that a list shows."""
    shown: Fields = {
        "run": [summary.run.name],
        "protocol": [summary.protocol],
        "exit_status": [summary.exit_status],
        "started": [summary.started],
        "trials_done": [summary.trials_done],
    }
    try:
        document = read_document(summary.run)
        if is_newer(document):
            return shown
        seal = read_seal(summary.run, document)
        annotations = _annotation_fields(read_annotations(summary.run, seal))
        fields = {**shown, **manifest_fields(document), **_file_fields(summary.run, seal), **annotations}
    except RecordError:
        return shown
    return {**fields, "exit_status": shown["exit_status"]}


def manifest_fields(manifest: Mapping[str, object]) -> Leaves:
    """Return the values of a manifest by dotted path, and `duration_s`."""
    fields = _leaves(manifest, "", _LEFT_OUT)
    duration_s = _duration_s(manifest)
    return fields if duration_s is None else {**fields, "duration_s": [duration_s]}


def _annotation_fields(annotations: Annotations) -> Leaves:
    """Return tags, verdict and notes; an absent one has no value, so that no other field matches its name."""
    return {
        "tag": list(annotations.tags),
        "verdict": [] if annotations.verdict is None else [annotations.verdict],
        "verdict_reason": [] if annotations.verdict_reason is None else [annotations.verdict_reason],
        "note": [note.text for note in annotations.notes],
    }


def _file_fields(run: Path, seal: Seal) -> Leaves:
    """Return the values of protocol.yaml and of the newest result; a file that cannot be read gives none."""
    fields: Leaves = {}
    with suppress(FileFormatError, RecordError):
        fields |= _protocol_fields(inside(run, PROTOCOL))
    with suppress(RecordError):
        fields |= _leaves(latest_result(run, _LONG_LISTS, seal) or {}, "result", _LEFT_OUT_OF_RESULTS)
    return fields


def _protocol_fields(path: Path) -> Leaves:
    """Return the values of protocol.yaml. Raises `FileFormatError`.

    Reading YAML takes milliseconds, and most of a protocol stands word for word in other runs too: so each of its
    top-level sections is read by itself, and once. A file that cannot be taken apart so is read as a whole.
    """
    fields: Leaves = {}
    try:
        for section in _SECTION.split(read_file(path, MAX_BYTES).decode("utf-8")):
            found = _section_fields(section)
            if fields.keys() & found.keys():
                return _leaves(load_yaml_values(path), "protocol", _LEFT_OUT)
            fields |= found
    except (OSError, ValueError, FileFormatError):
        return _leaves(load_yaml_values(path), "protocol", _LEFT_OUT)
    return fields


@lru_cache(maxsize=10_000)
def _section_fields(text: str) -> Leaves:
    return _leaves(parse_yaml_values(text, "section"), "protocol", _LEFT_OUT) if text.strip() else {}


def _leaves(values: Mapping[str, object], prefix: str, left_out: frozenset[str]) -> Leaves:
    """Return the scalars of nested values by dotted path, each once; the items of a list share its path."""
    found: dict[str, dict[Value, None]] = {}
    _gather(values, prefix, left_out, found)
    return {plain_text(path): list(held) for path, held in found.items()}


def _gather(value: object, path: str, left_out: frozenset[str], found: dict[str, dict[Value, None]]) -> None:
    if isinstance(value, dict):
        for key, item in value.items():
            if key not in left_out:
                _gather(item, f"{path}.{key}" if path else key, left_out, found)
    elif isinstance(value, list):
        for item in value:
            _gather(item, path, left_out, found)
    elif isinstance(value, str):
        found.setdefault(path, {})[plain_text(value)] = None
    elif value is None or isinstance(value, int | float):
        found.setdefault(path, {})[value if value is None or math.isfinite(value) else None] = None


def _duration_s(manifest: Mapping[str, object]) -> float | None:
    started, ended = manifest.get("started"), manifest.get("ended")
    try:
        return (datetime.fromisoformat(str(ended)) - datetime.fromisoformat(str(started))).total_seconds()
    except (ValueError, TypeError):
        return None
