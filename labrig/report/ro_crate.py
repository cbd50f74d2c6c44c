"""Describes the files of a run, comparison or campaign as an RO-Crate 1.1; needs the extra `rocrate` of labrig.

Sources: RO-Crate Metadata Specification 1.1 (https://w3id.org/ro/crate/1.1), schema.org; ISO 7064 for the check
character of an ORCID.
"""

import mimetypes
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from rocrate.model.contextentity import ContextEntity
from rocrate.model.person import Person
from rocrate.rocrate import ROCrate

from labrig import __version__
from labrig.durable import disk_errors
from labrig.errors import InputError
from labrig.input_file import parse_json, read_file
from labrig.record.digest import hash_file
from labrig.record.layout import CAMPAIGN
from labrig.record.reader import Run
from labrig.report.comparison_page import DOCUMENT_FILE as COMPARISON_FILE
from labrig.text import format_count

CRATE_FILE = "ro-crate-metadata.json"
CAMPAIGN_RESULT = "result.json"
_VERSION = "1.1"
_SPDX = "https://spdx.org/licenses/"
_STATUS = {"success": "CompletedActionStatus", "incomplete": "ActiveActionStatus"}
_MEDIA_TYPES = {".jsonl": "application/jsonl", ".yaml": "application/yaml", ".log": "text/plain"}


@dataclass(frozen=True)
class Author:
    """A person who made a run: the name, and the ORCID (https://orcid.org) if it was given."""

    name: str
    orcid: str | None


def read_author(text: str) -> Author:
    """Return the person in `Name` or `Name <0000-0000-0000-0000>`.

    Raises
    ------
    InputError
        When there is no name, or the ORCID does not have the check character that it should.
    """
    found = re.fullmatch(r"\s*([^<>]*[^<>\s])\s*(?:<\s*(?:https?://orcid\.org/)?([^<>\s]*)\s*>)?\s*", text)
    if found is None:
        raise InputError(f"the author {text!r} has no name", "write: 'Name' or 'Name <ORCID>'")
    name, orcid = found.groups()
    if orcid is not None and not _is_orcid(orcid):
        raise InputError(
            f"{orcid!r} is no ORCID", "it has four groups of four characters; look it up at orcid.org"
        )
    return Author(name, orcid)


def _is_orcid(text: str) -> bool:
    """Return whether the last character fits the others (ISO 7064, MOD 11-2)."""
    if not re.fullmatch(r"(\d{4}-){3}\d{3}[\dX]", text, re.ASCII):
        return False
    total = 0
    for digit in text.replace("-", "")[:-1]:
        total = (total + int(digit)) * 2
    return "0123456789X"[(12 - total % 11) % 11] == text[-1]


def read_license(text: str) -> str:
    """Return the address of a licence that is given by its SPDX identifier or its address.

    Raises
    ------
    InputError
        When it is neither.
    """
    if re.fullmatch(r"https?://[^\s<>\"]+", text):
        return text
    if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9.+-]*", text):
        return f"{_SPDX}{text}"
    raise InputError(f"{text!r} is no licence", "give its SPDX identifier, such as CC-BY-4.0, or its address")


@dataclass(frozen=True)
class CrateContent:
    """What the files of a crate are, and the schema.org CreateAction that made them.

    Attributes
    ----------
    name, description : str
        Of the crate.
    place : str
        Identifier of the action in the crate, such as `#run`.
    action : mapping
        Its properties, without instruments and files.
    instruments : tuple of (str, mapping)
        Identifier and properties of the program and the devices.
    """

    name: str
    description: str
    place: str
    action: Mapping[str, object]
    instruments: tuple[tuple[str, Mapping[str, str]], ...]


def describe_run(run: Run) -> CrateContent:
    """Return what the files of a run are, and how it was made."""
    rig = _section(run.manifest, "devices").get("kind")
    return CrateContent(
        name=str(run.manifest.get("title") or run.manifest.get("run")),
        description=f"A run of the experiment {run.manifest.get('experiment')} by labrig, exit status "
        f"{run.manifest.get('exit_status')}" + (f", on a {rig} rig." if rig else "."),
        place="#run",
        action=_describe_action(run),
        instruments=tuple(_list_instruments(run.manifest)),
    )


def describe_comparison(folder: Path) -> CrateContent:
    """Return what the files of `labrig compare` in a folder are: which quantity of which runs.

    Raises
    ------
    InputError
        When its document cannot be read.
    """
    try:
        document = parse_json(read_file(folder / COMPARISON_FILE))
        if not isinstance(document, Mapping):
            raise TypeError
        quantity, runs = document["quantity"], [str(used["run"]) for used in document["used"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{folder / COMPARISON_FILE} cannot be read as a comparison", "compare the runs again"
        ) from error
    compared = f"{quantity} of {format_count(len(runs), 'run')}, compared by labrig"
    return CrateContent(
        name=f"{quantity} of {', '.join(runs)}",
        description=f"{compared}: {', '.join(runs)}.",
        place="#comparison",
        action={
            "@type": "CreateAction",
            "name": compared,
            "actionStatus": "http://schema.org/CompletedActionStatus",
        },
        # Which version compared them is not in the document.
        instruments=(("#labrig", {"@type": "SoftwareApplication", "name": "labrig"}),),
    )


def describe_campaign(folder: Path) -> CrateContent:
    """Return what the files of `labrig campaign` in a folder are: which protocol was repeated, and how often.

    Raises
    ------
    InputError
        When its documents cannot be read, or its page was not written yet.
    """
    try:
        result: Any = parse_json(read_file(folder / CAMPAIGN_RESULT))
        begun: Any = parse_json(read_file(folder / CAMPAIGN))
        repeated = (
            f"{format_count(result['done'], 'task')} of {result['experiment']} in {len(result['arms'])} arms"
        )
        name, program = str(result["title"] or result["campaign"]), str(begun["installation"]["labrig"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{folder} cannot be read as a finished campaign", "labrig campaign FILE goes on with it"
        ) from error
    status = "ActiveActionStatus" if result.get("ended") == "incomplete" else "CompletedActionStatus"
    return CrateContent(
        name=name,
        description=f"A campaign by labrig: {repeated}, virtual and compared by {result.get('measure')}.",
        place="#campaign",
        action={"@type": "CreateAction", "name": repeated, "actionStatus": f"http://schema.org/{status}"},
        instruments=(
            ("#labrig", {"@type": "SoftwareApplication", "name": "labrig", "softwareVersion": program}),
        ),
    )


def describe_crate(
    content: CrateContent,
    folder: Path,
    *,
    license_url: str,
    authors: Sequence[Author],
    published: datetime,
) -> None:
    """Write `folder`/ro-crate-metadata.json, which describes every file in the folder and how they were made.

    Parameters
    ----------
    content : CrateContent
        What the files are.
    folder : Path
        The root of the crate, with its files in place.
    license_url : str
        Licence of the files.
    authors : sequence of Author
        Who made them, in their order; at least one.
    published : datetime
        Date of the export, aware.

    Raises
    ------
    DiskError
        When it cannot be written.
    """
    crate = ROCrate(version=_VERSION)
    crate.name, crate.description = content.name, content.description
    crate.datePublished = published
    crate.license = crate.add(
        ContextEntity(crate, license_url, {"@type": "CreativeWork", "name": license_url})
    )
    crate.root_dataset["author"] = [crate.add(_make_person(crate, author)) for author in authors]
    files = [_add_file(crate, folder, path) for path in sorted(folder.rglob("*")) if path.is_file()]
    instruments = [crate.add(ContextEntity(crate, *entity)) for entity in content.instruments]
    made_by = {**content.action, "instrument": instruments, "result": files}
    crate.add(ContextEntity(crate, content.place, made_by))
    crate.root_dataset["mentions"] = crate.dereference(content.place)
    with disk_errors(folder / CRATE_FILE):
        crate.metadata.write(folder)


def _make_person(crate: ROCrate, author: Author) -> Person:
    place = f"https://orcid.org/{author.orcid}" if author.orcid else f"#{'-'.join(author.name.split())}"
    return Person(crate, place, {"name": author.name})


def _add_file(crate: ROCrate, folder: Path, path: Path) -> Any:
    name = path.relative_to(folder).as_posix()
    kind = _MEDIA_TYPES.get(path.suffix) or mimetypes.guess_type(name)[0] or "application/octet-stream"
    about = {
        "name": name,
        "encodingFormat": kind,
        "contentSize": str(path.stat().st_size),
        "sha256": hash_file(path),
    }
    return crate.add_file(path, dest_path=name, properties=about)


def _describe_action(run: Run) -> dict[str, object]:
    """Return what the run was, as a schema.org CreateAction; it is active while the run has not ended."""
    status = _STATUS.get(str(run.manifest.get("exit_status")), "FailedActionStatus")
    times = {"startTime": run.manifest.get("started"), "endTime": run.manifest.get("ended")}
    return {
        "@type": "CreateAction",
        "name": str(run.manifest.get("run")),
        "actionStatus": f"http://schema.org/{status}",
        **{key: str(value) for key, value in times.items() if value},
    }


def _list_instruments(manifest: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield identifier and properties of the program, the drive of each axis, and the camera."""
    program = str(_section(manifest, "provenance").get("labrig", __version__))
    yield "#labrig", {"@type": "SoftwareApplication", "name": "labrig", "softwareVersion": program}
    devices = _section(manifest, "devices")
    for axis, described in _section(devices, "axes").items():
        drive = _section({"": described}, "").get("drive")
        yield f"#axis-{axis}", _describe_product(f"drive of the axis {axis}", _section({"": drive}, ""))
    if camera := _section(devices, "camera"):
        yield (
            "#camera",
            _describe_product(f"camera ({camera.get('driver')})", {"model": camera.get("device")}),
        )


def _describe_product(name: str, device: Mapping[str, Any]) -> dict[str, str]:
    known = {"model": device.get("model"), "serialNumber": device.get("serial_number")}
    return {
        "@type": "IndividualProduct",
        "name": name,
        **{key: str(value) for key, value in known.items() if value},
    }


def _section(above: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """Return a section of a manifest, empty if a record has none."""
    found = above.get(key)
    return found if isinstance(found, Mapping) else {}
