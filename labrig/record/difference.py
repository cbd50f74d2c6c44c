"""What differs between runs: endings, protocols, rigs, calibrations, versions, devices and results."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import TypeAlias

from labrig.record.json_lines import Value, flatten
from labrig.record.reader import Run

_RUN_KEYS = ("experiment", "title", "exit_status", "reason", "trials_planned", "summary", "seed", "operator")
# Time and origin of a result are not compared; versions have a section of their own.
_STAMP = frozenset({"created", "inputs", "parent", "provenance", "schema_version"})

Differing: TypeAlias = tuple[str, str, tuple[Value, ...]]
"""Section, dotted path, and the value in each run."""


@dataclass(frozen=True)
class Difference:
    """A value that differs between two runs.

    Attributes
    ----------
    section : str
        `run`, `protocol`, `rig`, `calibration`, `versions`, `devices` or `results`.
    key : str
        Dotted path in it; items of a list by their number.
    a, b : str, int, float, bool or None
        The value in each; None also if it is absent.
    """

    section: str
    key: str
    a: Value
    b: Value


def list_differences(a: Run, b: Run) -> tuple[Difference, ...]:
    """Compare the records of two runs section by section.

    Raises
    ------
    RecordError
        When a file of a run is missing or was changed.
    FileFormatError
        When a protocol or rig file is no YAML.
    """
    found = _compare(_read_sections(a), _read_sections(b))
    return tuple(Difference(section, key, *values) for section, key, values in found)


def list_conditions(*runs: Run) -> Iterator[Differing]:
    """Yield what differs in what runs were made with: protocols, rigs, calibrations, versions and devices."""
    return _compare(*map(_read_conditions, runs))


def _compare(*runs: Mapping[str, object]) -> Iterator[Differing]:
    for section in runs[0]:
        for key, values in find_differences(*(sections[section] for sections in runs)):
            yield section, key, values


def find_differences(*documents: object) -> Iterator[tuple[str, tuple[Value, ...]]]:
    """Yield the dotted path and the values of each scalar that is not the same in all documents, in their order."""
    flat = [dict(flatten(document, number_items=True)) for document in documents]
    for key in dict.fromkeys(chain.from_iterable(flat)):
        values = tuple(each.get(key) for each in flat)
        if any(value != values[0] for value in values):
            yield key, values


def _read_sections(run: Run) -> dict[str, Mapping[str, object]]:
    return {
        "run": {key: run.manifest.get(key) for key in _RUN_KEYS},
        **_read_conditions(run),
        "results": {key: value for key, value in (run.result or {}).items() if key not in _STAMP},
    }


def _read_conditions(run: Run) -> dict[str, Mapping[str, object]]:
    return {
        "protocol": run.protocol,
        "rig": run.rig,
        "calibration": {name: {"sha256": sha256} for name, sha256 in run.calibration_hashes.items()},
        "versions": {**(run.manifest.get("provenance") or {}), "command_line": None},
        "devices": run.devices,
    }
