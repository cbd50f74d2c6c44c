"""Compare two runs: endings, protocols, rigs, calibrations, versions, devices and results."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TypeGuard

from labrig.errors import RecordError
from labrig.input_file import parse_json, read_file
from labrig.protocol.yaml_tree import load_yaml_values
from labrig.record.layout import CALIBRATION, COPY_HINT, PROTOCOL, RIG, inside
from labrig.record.manifest import calibration_sha256, read_manifest
from labrig.record.results import latest_result
from labrig.record.run_index import Value

_RUN_KEYS = (
    "experiment",
    "title",
    "exit_status",
    "reason",
    "trials_planned",
    "trials_done",
    "seed",
    "operator",
    "recording",
)
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


def compare_runs(a: Path, b: Path) -> tuple[Difference, ...]:
    """Compare the records of two runs section by section.

    Raises
    ------
    RecordError
        When a folder is no run, or a file in it cannot be read.
    FileFormatError
        When a protocol or rig file is no YAML.
    """
    sections_a, sections_b = _read_sections(a), _read_sections(b)
    return tuple(
        chain.from_iterable(
            _compare_section(section, sections_a[section], sections_b[section]) for section in sections_a
        )
    )


@dataclass(frozen=True)
class DifferenceGroup:
    """The differences of the items of a list in one value.

    Attributes
    ----------
    key : str
        Dotted path, with `*` in place of the numbers of items.
    first : Difference
        The first of them.
    count : int
        How many differ.
    mean, largest : float or None
        Mean and largest size of the differences of those that are numbers in both runs; None without any.
    """

    key: str
    first: Difference
    count: int
    mean: float | None
    largest: float | None


def group_differences(differences: Iterable[Difference]) -> tuple[DifferenceGroup, ...]:
    """Return differences with those of a list's items together, in the order in which each first occurs."""
    groups: dict[str, list[Difference]] = {}
    for difference in differences:
        parts = difference.key.split(".")
        key = ".".join("*" if part.isdigit() else part for part in parts)
        groups.setdefault(key, []).append(difference)
    return tuple(_summarise(key, group) for key, group in groups.items())


def _summarise(key: str, group: Sequence[Difference]) -> DifferenceGroup:
    sizes = [
        abs(difference.b - difference.a)
        for difference in group
        if _is_number(difference.a) and _is_number(difference.b)
    ]
    mean = sum(sizes) / len(sizes) if sizes else None
    return DifferenceGroup(key, group[0], len(group), mean, max(sizes, default=None))


def _is_number(value: Value) -> TypeGuard[int | float]:
    return isinstance(value, int | float) and not isinstance(value, bool)


def find_differences(a: object, b: object) -> Iterator[tuple[str, Value, Value]]:
    """Yield the dotted path and both values of each scalar that differs between two documents, in their order."""
    ours, theirs = dict(_walk(a, "")), dict(_walk(b, ""))
    for key in dict.fromkeys((*ours, *theirs)):
        if (before := ours.get(key)) != (after := theirs.get(key)):
            yield key, before, after


def _compare_section(section: str, a: object, b: object) -> Iterator[Difference]:
    return (Difference(section, *found) for found in find_differences(a, b))


def _read_sections(run: Path) -> dict[str, Mapping[str, object]]:
    manifest = read_manifest(run)
    provenance = _as_mapping(manifest.get("provenance"))
    result = latest_result(run) or {}
    return {
        "run": {key: manifest.get(key) for key in _RUN_KEYS},
        "protocol": _read_yaml(run, PROTOCOL),
        "rig": _read_yaml(run, RIG),
        "calibration": _read_calibration(run, manifest),
        "versions": {
            **{key: value for key, value in provenance.items() if key != "command_line"},
            # Shows whether two modified checkouts of one commit were modified alike.
            "code_diff_sha256": _as_mapping(manifest.get("hashes")).get("code_diff_sha256"),
        },
        "devices": _as_mapping(manifest.get("devices")),
        "results": {key: value for key, value in result.items() if key not in _STAMP},
    }


def _read_yaml(run: Path, name: str) -> Mapping[str, object]:
    path = inside(run, name)
    return load_yaml_values(path) if path.exists() else {}


def _read_calibration(run: Path, manifest: Mapping[str, object]) -> dict[str, object]:
    """Return the SHA-256 of each calibration file, and its content if it is JSON."""
    return {
        name: {"sha256": sha256, **_read_document(run, name)}
        for name, sha256 in calibration_sha256(manifest).items()
    }


def _read_document(run: Path, name: str) -> Mapping[str, object]:
    path = inside(run, f"{CALIBRATION}/{name}")
    if path.suffix != ".json":
        return {}
    try:
        document = _as_mapping(parse_json(read_file(path)))
    except (OSError, ValueError) as error:
        raise RecordError(f"cannot read {path}: {error}", COPY_HINT) from error
    return {key: value for key, value in document.items() if key not in {*_STAMP, "views"}}


def _as_mapping(value: object) -> Mapping[str, object]:
    return value if isinstance(value, Mapping) else {}


def _walk(value: object, path: str) -> Iterator[tuple[str, Value]]:
    if isinstance(value, Mapping):
        items = value.items()
    elif isinstance(value, list | tuple):
        items = dict(enumerate(value)).items()
    else:
        yield path, value if isinstance(value, str | int | float) else None
        return
    for key, item in items:
        yield from _walk(item, f"{path}.{key}" if path else str(key))
