"""What differs between two runs: endings, protocols, rigs, calibrations, versions, devices and results."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from labrig.protocol.yaml_text import load_yaml_values
from labrig.record.json_lines import Value, flatten
from labrig.record.reader import Run

_RUN_KEYS = ("experiment", "title", "exit_status", "reason", "trials_planned", "summary", "seed", "operator")
# Time and origin of a result are not compared; versions have a section of their own.
_STAMP = frozenset({"created", "inputs", "parent", "provenance", "schema_version"})


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
    ours, theirs = _read_sections(a), _read_sections(b)
    return tuple(
        Difference(section, *found)
        for section in ours
        for found in find_differences(ours[section], theirs[section])
    )


def find_differences(a: object, b: object) -> Iterator[tuple[str, Value, Value]]:
    """Yield the dotted path and both values of each scalar that differs between two documents, in their order."""
    ours, theirs = dict(flatten(a, number_items=True)), dict(flatten(b, number_items=True))
    for key in dict.fromkeys((*ours, *theirs)):
        if (before := ours.get(key)) != (after := theirs.get(key)):
            yield key, before, after


def _read_sections(run: Run) -> dict[str, Mapping[str, object]]:
    manifest = run.manifest
    rig = run.rig_path
    calibration = {name: {"sha256": sha256} for name, sha256 in run.calibration_hashes.items()}
    return {
        "run": {key: manifest.get(key) for key in _RUN_KEYS},
        "protocol": run.protocol,
        "rig": {} if rig is None else load_yaml_values(rig),
        "calibration": calibration,
        "versions": {**(manifest.get("provenance") or {}), "command_line": None},
        "devices": run.devices,
        "results": {key: value for key, value in (run.result or {}).items() if key not in _STAMP},
    }
