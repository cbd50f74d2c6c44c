"""The marker file of a lab folder: which labrig wrote its files, and what they were."""

import json
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from packaging.version import InvalidVersion, Version

from labrig.errors import InputError
from labrig.input_file import parse_json, read_file
from labrig.lab.folder import MARKER

FORMAT = 1
"""Version of the marker file; a higher one needs a newer labrig."""


@dataclass(frozen=True)
class Marker:
    """What the marker file says.

    Attributes
    ----------
    labrig : str
        The version of labrig that wrote the examples.
    files : mapping of str to str
        Place of an example in the lab folder -> SHA-256 of what labrig wrote there.
    format : int
        Version of the marker file.
    """

    labrig: str
    files: Mapping[str, str]
    format: int = FORMAT

    def encode(self) -> bytes:
        """Return the content of the marker file."""
        document = {"format": self.format, "labrig": self.labrig, "files": dict(self.files)}
        return (json.dumps(document, indent=2) + "\n").encode("utf-8")

    def is_newer_than(self, labrig: str) -> bool:
        """Return whether it was written by a newer labrig than the version given."""
        return self.format > FORMAT or Version(self.labrig) > Version(labrig)

    def explain_newer(self, labrig: str) -> tuple[str, str]:
        """Return by which labrig it was written, newer than the version given, and what to install."""
        if Version(self.labrig) > Version(labrig):
            return (
                f"by labrig {self.labrig}, which is newer than this labrig {labrig}",
                f"install labrig {self.labrig} or a newer one",
            )
        read = f"{MARKER} has format {self.format}, and formats up to {FORMAT} are read"
        return f"by a labrig newer than this labrig {labrig}: {read}", "install a newer labrig"

    def is_older_than(self, labrig: str) -> bool:
        """Return whether it was written by an older labrig than the version given."""
        return not self.is_newer_than(labrig) and Version(self.labrig) < Version(labrig)


def make_marker(labrig: str, files: Mapping[str, bytes]) -> Marker:
    """Return the marker of a lab folder that holds these examples of a version of labrig."""
    return Marker(labrig, {place: hash_content(content) for place, content in files.items()})


def hash_content(content: bytes) -> str:
    """Return the SHA-256 of a file's content."""
    return sha256(content).hexdigest()


def read_marker(folder: Path) -> Marker | None:
    """Return the marker of a lab folder; None if it has none, as a checkout.

    Raises
    ------
    InputError
        When the marker file is damaged.
    """
    path = folder / MARKER
    try:
        return _parse(read_file(path))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError, InvalidVersion) as error:
        raise InputError(
            f"{path} is damaged: labrig does not know which version wrote the examples of this lab folder",
            f"move it away, then: labrig init --update {shlex.quote(str(folder))}; files that differ are kept",
        ) from error


def _parse(content: bytes) -> Marker:
    document = parse_json(content)
    if not isinstance(document, dict) or not isinstance(document["format"], int):
        raise TypeError
    Version(str(document["labrig"]))
    # A later format may keep its files otherwise.
    files = document["files"] if document["format"] <= FORMAT else {}
    return Marker(
        str(document["labrig"]),
        {str(place): str(digest) for place, digest in files.items()},
        document["format"],
    )
