"""Seal a run: append links over what was recorded, measured and written about it.

A file is complete before the link that covers it, so a process that is stopped between the two leaves a file without a
link. Only the manifest of a closing run goes into place after its link, and until then lies beside it: whoever finds
both finishes the closing.
"""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from labrig.durable import disk_errors, write_atomically
from labrig.input_file import MAX_LOG_BYTES, read_file
from labrig.posix import sync_directory
from labrig.record.chain import Kind, Link, Time, append_link, encode_link, hash_link
from labrig.record.digest import hash_file
from labrig.record.layout import (
    ANALYSIS,
    CAN_LOG,
    CHAIN,
    CLOSING,
    MANIFEST,
    NOTES,
    RAW_PICTURES,
    SHA256SUMS,
    TORN,
    inside,
)
from labrig.record.seal import Seal, count_unsealed_notes, is_closing, list_unsealed_results, read_seal

_ALSO_SEALED = re.compile(r"code\.\d{3,}\.diff|SHA256SUMS\.\d{3,}|manifest\.\d{3,}\.json")


def first_link(sums: Mapping[str, str], at: Time) -> tuple[bytes, str]:
    """Return the first link of a run, over the files that it begins with, and its hash."""
    line = encode_link(1, "open", at, sums)
    return line, hash_link(line)


def seal_again(run: Path, retired: Iterable[str]) -> Link:
    """Append the link of a run that goes on, over what was kept of its closing.

    The chain of a record without one begins with this, over its results and annotations too.
    """
    names = list(retired)
    lengths = {}
    if not (run / CHAIN).exists():
        names += list_files(run, ANALYSIS)
        if (notes := inside(run, NOTES)).is_file():
            lengths[NOTES] = notes.stat().st_size
    return append_link(run, "open", None, _hash_files(run, names, lengths), lengths)


def seal_closing(run: Path, manifest: bytes, sums: Mapping[str, str], at: Time) -> None:
    """Append the link that closes a run, over every raw file, and put its manifest into place.

    Parameters
    ----------
    manifest : bytes
        As the closed run has it.
    sums : Mapping
        The content of SHA256SUMS, which is on disk already. It covers the files that it lists.

    Raises
    ------
    DiskError
        When it cannot be written; the run stays `incomplete`, and readable.
    """
    write_atomically(run / CLOSING, manifest)
    also = [path.name for path in run.iterdir() if _ALSO_SEALED.fullmatch(path.name)]
    names = sorted({SHA256SUMS, *also, *list_files(run, TORN)} - sums.keys())
    grown = {name: sha256 for name, sha256 in sums.items() if _grows(name)}
    files = {MANIFEST: hash_file(run / CLOSING), **_hash_files(run, names), **grown}
    append_link(run, "close", at, files, {name: (run / name).stat().st_size for name in grown})
    put_manifest_in_place(run)


def put_manifest_in_place(run: Path) -> None:
    """Put the manifest of a run that is being closed into place. Raises `DiskError`."""
    with disk_errors(run / MANIFEST):
        (run / CLOSING).replace(run / MANIFEST)
        sync_directory(run)


def finish_closing(run: Path) -> bool:
    """Finish the closing of a run if labrig was stopped in it, and return whether it was."""
    if not is_closing(read_seal(run)):
        return False
    put_manifest_in_place(run)
    return True


def seal_files(run: Path, kind: Kind, names: Iterable[str], at: Time) -> None:
    """Append a link over files that were written into a run: `result` or `page`.

    A record without a chain gets none.

    Raises
    ------
    DiskError
        When it cannot be written.
    """
    if (run / CHAIN).exists():
        append_link(run, kind, at, _hash_files(run, names))


def seal_notes(run: Path, at: Time) -> None:
    """Append a link over the annotations of a run as they are now. Raises as `seal_files`."""
    if (run / CHAIN).exists():
        lengths = {NOTES: inside(run, NOTES).stat().st_size}
        append_link(run, "note", at, _hash_files(run, (), lengths), lengths)


def seal_leftovers(run: Path, at: Time) -> bool:
    """Append a link over results and annotations that have none; return whether there were some.

    Such a link is of the kind `unsealed`: nothing shows what wrote these files.
    """
    seal: Seal = read_seal(run)
    names = [name for folder in list_unsealed_results(seal) for name in list_files(run, folder)]
    has_notes = bool(count_unsealed_notes(seal))
    if not seal.links or not (names or has_notes):
        return False
    lengths = {NOTES: _length_of_whole_lines(run / NOTES)} if has_notes else {}
    append_link(run, "unsealed", at, _hash_files(run, names, lengths), lengths)
    return True


def list_files(run: Path, folder: str) -> list[str]:
    """Return the files below a folder of a run, relative to the run; without links, and hidden ones only of torn/."""
    paths = (path for path in inside(run, folder).rglob("*") if path.is_file() and not path.is_symlink())
    names = (path.relative_to(run).as_posix() for path in paths)
    return sorted(name for name in names if folder == TORN or not name.rpartition("/")[2].startswith("."))


def _hash_files(run: Path, names: Iterable[str], lengths: Mapping[str, int] | None = None) -> dict[str, str]:
    grown = {name: hash_file(run / name, length) for name, length in (lengths or {}).items()}
    return {name: hash_file(run / name) for name in names} | grown


def _grows(name: str) -> bool:
    """Return whether a later session of the run may add to a file."""
    return name.endswith(".jsonl") or name in {CAN_LOG, RAW_PICTURES}


def _length_of_whole_lines(path: Path) -> int:
    return read_file(path, MAX_LOG_BYTES).rfind(b"\n") + 1
