"""The chain of a run: what was sealed, and in which order.

`RUN/chain.jsonl` is append-only, one CRC line a link: its number, kind and time, the SHA-256 of each file that it
covers, and the hash of the link before it. The hash of a link is the SHA-256 of its line, newline included:
`sed -n 2p chain.jsonl | sha256sum`. So the hash of one link vouches for all links before it, and for their files.
"""

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from labrig.durable import append_or_restore, disk_errors, open_descriptor
from labrig.errors import Problem, RecordError
from labrig.input_file import MAX_LOG_BYTES, read_file
from labrig.posix import lock
from labrig.record.json_lines import decode_line, encode_line
from labrig.record.layout import CHAIN, COPY_HINT, inside

Kind = Literal["open", "close", "result", "note", "page", "unsealed"]
"""`unsealed` covers what was found without a link by `labrig runs check --repair`."""

Time = object
"""An aware datetime, or ISO 8601 text; None if it is not known."""
_NO_LENGTHS: Mapping[str, int] = {}


@dataclass(frozen=True)
class Link:
    """A link of the chain.

    Attributes
    ----------
    number : int
        From 1.
    kind : str
        What was sealed: see `Kind`.
    at : str or None
        When, ISO 8601 in UTC; None where a record without a chain was continued.
    files : Mapping
        SHA-256 of each file that it covers, by its name in the run.
    lengths : Mapping
        How many bytes of a file that still grows that hash is of.
    sha256 : str
        The hash of the link.
    """

    number: int
    kind: str
    at: str | None
    files: Mapping[str, str]
    lengths: Mapping[str, int]
    sha256: str


@dataclass(frozen=True)
class ChainScan:
    """The links up to the first that is damaged or does not continue the one before it, and what is wrong."""

    links: tuple[Link, ...]
    damaged: tuple[Problem, ...] = ()
    torn: tuple[Problem, ...] = ()


def encode_link(  # noqa: PLR0917 - the members of a line, in their order
    number: int,
    kind: Kind,
    at: Time,
    files: Mapping[str, str],
    lengths: Mapping[str, int] = _NO_LENGTHS,
    previous: str | None = None,
) -> bytes:
    """Encode a link, its newline included; `previous` is the hash of the link before it."""
    fields = {"link": number, "kind": kind, "at": at, "files": files}
    grown = {"bytes": lengths} if lengths else {}
    return encode_line({**fields, **grown, "previous": previous})


def hash_link(line: bytes) -> str:
    """Return the hash of an encoded link."""
    return hashlib.sha256(line).hexdigest()


def scan_chain(run: Path) -> ChainScan:
    """Read the chain of a run; a run without one has no links. Raises `RecordError` when it cannot be read."""
    path = inside(run, CHAIN)
    try:
        *lines, rest = read_file(path, MAX_LOG_BYTES).split(b"\n")
    except FileNotFoundError:
        return ChainScan(())
    except OSError as error:
        raise RecordError(f"cannot read {path}: {error.strerror}", COPY_HINT) from error
    torn = _find_torn_end(rest, len(lines) + 1)
    if rest and _is_link(rest):
        lines.append(rest)
    links: list[Link] = []
    for number, line in enumerate(lines, start=1):
        try:
            links.append(_parse_link(line, number, links[-1].sha256 if links else None))
        except ValueError as error:
            return ChainScan(tuple(links), (Problem(f"{CHAIN}:{number}", str(error), COPY_HINT),), torn)
    return ChainScan(tuple(links), (), torn)


def append_link(
    run: Path, kind: Kind, at: Time, files: Mapping[str, str], lengths: Mapping[str, int] = _NO_LENGTHS
) -> Link:
    """Append a link to the chain of a run; it is durable when this returns.

    Two processes that append at once wait for each other.

    Raises
    ------
    DiskError
        When it cannot be written; the chain is as it was.
    """
    path = inside(run, CHAIN)
    with disk_errors(path), open_descriptor(path, os.O_RDWR | os.O_CREAT | os.O_APPEND) as descriptor:
        lock(descriptor, wait=True)
        content = read_file(path, MAX_LOG_BYTES)
        end = content.rfind(b"\n") + 1
        # A killed process may leave a torn link, or a link that lacks its newline. A torn one was never acknowledged.
        before = content + b"\n" if _is_link(content[end:]) else content[:end]
        lines = before.split(b"\n")[:-1]
        previous = hash_link(lines[-1] + b"\n") if lines else None
        line = encode_link(len(lines) + 1, kind, at, files, lengths, previous)
        os.ftruncate(descriptor, end)
        append_or_restore(descriptor, before[end:] + line, end)
        os.fsync(descriptor)
    return _parse_link(line.rstrip(b"\n"), len(lines) + 1, previous)


def find_link(links: tuple[Link, ...], root: str) -> Link | None:
    """Return the link whose hash begins with these hexadecimal digits; None without one."""
    return next((link for link in links if link.sha256.startswith(root)), None)


def newest_links(links: tuple[Link, ...]) -> dict[str, Link]:
    """Return the newest link that covers each file."""
    return {name: link for link in links for name in link.files}


def _is_link(rest: bytes) -> bool:
    try:
        decode_line(rest)
    except ValueError:
        return False
    return True


def _find_torn_end(rest: bytes, number: int) -> tuple[Problem, ...]:
    if not rest:
        return ()
    message = f"the last link is torn after {len(rest)} bytes: labrig was stopped, or the file was cut"
    return (Problem(f"{CHAIN}:{number}", message, "what it covered is named; " + COPY_HINT),)


def _parse_link(line: bytes, number: int, previous: str | None) -> Link:
    """Return the link of a line without its newline. Raises `ValueError` if it is not the next link."""
    try:
        fields = decode_line(line)
    except ValueError as error:
        raise ValueError(f"the link is damaged: {error}") from error
    if fields.get("link") != number or fields.get("previous") != previous:
        raise ValueError("it does not continue the link before it: a link was changed, removed or added")
    files, lengths, at = fields.get("files"), fields.get("bytes", {}), fields.get("at")
    if not isinstance(files, dict) or not isinstance(lengths, dict) or not all(map(is_inner_name, files)):
        raise ValueError("the link does not say which files it covers")
    if not all(isinstance(length, int) and length >= 0 for length in lengths.values()):
        raise ValueError("the link does not say how much of a file it covers")
    return Link(
        number,
        str(fields.get("kind")),
        at if isinstance(at, str) else None,
        {name: str(sha256) for name, sha256 in files.items()},
        lengths,
        hash_link(line + b"\n"),
    )


def is_inner_name(name: str) -> bool:
    """Return whether a name leads to a place within the run."""
    return not any(part in {"", ".", ".."} for part in name.split("/"))
