"""The provenance section of a page: code, inputs, settings, calibration, devices."""

import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from labrig.analysis.result import AnyResult
from labrig.record.reader import Run
from labrig.report.formatting import Rows, flatten, format_time, format_value


@dataclass(frozen=True)
class Section:
    """A table of keys and values with a heading."""

    title: str
    rows: Rows


@dataclass(frozen=True)
class Provenance:
    """What a page rests on: `essentials` are always in view, `details` are folded; `files` hold all of it."""

    essentials: tuple[Section, ...]
    details: tuple[Section, ...]
    files: tuple[str, ...]


def make_provenance(run: Run, result: AnyResult | None, calibration: Rows = ()) -> Provenance:
    """Return the provenance of a page, without sections that are empty."""
    essentials = (Section("In short", _list_essentials(run, result)), Section("Calibration", calibration))
    results = () if result is None else (f"analysis/{result.path.name}/result.json",)
    return Provenance(
        tuple(section for section in essentials if section.rows),
        tuple(section for section in _make_details(run, result) if section.rows),
        ("manifest.json", *results),
    )


def describe_code(provenance: object) -> str:
    """Return version and commit of labrig, and whether it was changed; without a commit, the digest of its code."""
    known = provenance if isinstance(provenance, Mapping) else {}
    digest = f", code of SHA-256 {known['source_sha256']}" if known.get("source_sha256") else ""
    commit = f", commit {known['git_commit']}" if known.get("git_commit") else digest
    changed = ", with changes in no commit" if known.get("git_dirty") else ""
    return f"labrig {known.get('labrig', 'of an unknown version')}{commit}{changed}"


def _list_essentials(run: Run, result: AnyResult | None) -> Rows:
    """Return the code, the rig and the result in a line each."""
    rig = run.devices.get("rig")
    # A run may be resumed many times with the same code.
    resumed = dict.fromkeys(describe_code(session.get("provenance")) for session in run.sessions)
    return (
        ("recorded with", describe_code(run.manifest.get("provenance"))),
        *(("resumed with", code) for code in resumed),
        *((("rig", format_value(rig)),) if rig else ()),
        *(() if result is None else _list_measurement(result)),
    )


def _list_measurement(result: AnyResult) -> Rows:
    return (
        ("measured with", describe_code(result.content.provenance)),
        ("result", f"analysis/{result.path.name}, {format_time(result.content.created)}"),
        ("changed after the run", ", ".join(result.content.overrides) or "nothing"),
    )


def _make_details(run: Run, result: AnyResult | None) -> tuple[Section, ...]:
    measured = () if result is None else _list_code(result.content.provenance)
    return (
        Section("Recorded with", _list_code(run.manifest.get("provenance"))),
        *_make_session_sections(run),
        Section("Measured with", measured),
        Section("Analysis", () if result is None else _list_analysis(result)),
        Section("SHA-256 of what was used", _list_hashes(run, result)),
        Section("Devices", _list_devices(run.devices)),
    )


def _make_session_sections(run: Run) -> Iterator[Section]:
    """Yield a section for each session after the first: its start and its code."""
    for number, session in enumerate(run.sessions, start=2):
        began = ("started", format_time(session.get("started")))
        yield Section(f"Resumed with, session {number}", (began, *_list_code(session.get("provenance"))))


def _list_analysis(result: AnyResult) -> Rows:
    content = result.content
    return (
        ("parent", "none" if content.parent is None else f"analysis/{content.parent:03d}"),
        *flatten(content.settings),
    )


def _list_hashes(run: Run, result: AnyResult | None) -> Rows:
    inputs = {} if result is None else result.content.inputs
    recorded = (row for row in run.hashes.items() if row[1] not in inputs.values())
    return (*inputs.items(), *recorded)


def _list_devices(devices: object) -> Rows:
    """Return the devices as they were read back; identities in the notation of their manuals."""
    return tuple((key, _format_identity(key, value)) for key, value in _list_rows(devices))


def _format_identity(key: str, value: str) -> str:
    name = key.rpartition(".")[2]
    if not value.isdecimal():
        return value
    # maxon's tables list versions in the form 0x6220, which is an EPOS2 24/5.
    if name in {"hardware_version", "software_version"}:
        return f"0x{int(value):04X}"
    return f"0x{int(value):08X}" if name in {"vendor_id", "product_code", "revision_number"} else value


def _list_rows(document: object) -> Rows:
    return tuple(flatten(document)) if isinstance(document, Mapping) else ()


def _list_code(document: object) -> Rows:
    """Return the provenance of a record or result; packages, processor and command take one line each."""
    if not isinstance(document, Mapping):
        return ()
    return _list_rows({key: _join_line(value) for key, value in document.items()})


def _join_line(value: object) -> object:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {version}" for name, version in value.items() if version is not None)
    return shlex.join(map(str, value)) if isinstance(value, list | tuple) else value
