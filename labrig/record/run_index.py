"""A cache of what was read from many runs, in SQLite: lost, stale or corrupt, it is made again from the folders.

Each row is the name of a run, a signature of the files that it was made from (time, size and inode), and a CRC line
that holds what was read. A row whose signature or checksum does not fit is made again; a file that is no database is
replaced; where the folder cannot be written, nothing is kept, and the answer is the same.
"""

import os
import sqlite3
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from labrig.record.json_lines import decode_line, encode_line

INDEX_FILE = ".catalogue.sqlite3"
NO_FILE = "-"
"""Stands in a signature for a file that is not there."""

_FORMAT = 3
_BUSY_TIMEOUT_S = 2.0

Row = dict[str, Any]


def remembered(
    runs_dir: Path, kind: str, signatures: Mapping[str, str], read: Callable[[str], Mapping[str, object]]
) -> dict[str, Row]:
    """Return what `read` says of each run, from the cache where the run's files have not changed since.

    Parameters
    ----------
    kind : str
        What is read of a run; each kind is kept apart.
    signatures : Mapping
        Name of the run's folder to the signature of the files that `read` looks at.
    read : callable
        Takes a name and returns what is to be kept, as JSON can say it.
    """
    path = runs_dir / INDEX_FILE
    cached = cached_rows(path, kind)
    rows: dict[str, Row] = {}
    fresh: list[tuple[bytes, str, str, bytes]] = []
    for name, signature in signatures.items():
        row = intact_row(cached.pop(os.fsencode(name), None), signature)
        if row is None:
            line = encode_line(read(name))
            fresh.append((os.fsencode(name), kind, signature, line))
            row = decode_line(line[:-1])
        rows[name] = row
    if fresh or cached:
        change_index(path, lambda index: _keep(index, kind, fresh, gone=cached))
    return rows


def signature_of(run: str, files: Iterable[str]) -> str:
    """Return what changes when one of the files of a run does; `run` is its folder."""
    parts = []
    for file in files:
        try:
            found = os.lstat(f"{run}/{file}")
        except OSError:
            parts.append(NO_FILE)
            continue
        parts.append(f"{found.st_mtime_ns}.{found.st_size}.{found.st_ino}")
    return " ".join(parts)


def intact_row(row: tuple[str, bytes] | None, signature: str) -> Row | None:
    """Return what a row says; None where there is none, or its signature or checksum does not fit."""
    if row is None or row[0] != signature:
        return None
    try:
        return decode_line(row[1][:-1])
    except (ValueError, TypeError):
        return None


def cached_rows(path: Path, kind: str) -> dict[bytes, tuple[str, bytes]]:
    """Return signature and line of all rows of a kind, by the name of the run; none where they cannot be read."""
    if not path.is_file() or path.is_symlink():
        return {}
    try:
        with closing(opened_index(path)) as index:
            query = "SELECT name, signature, line FROM runs WHERE kind = ?"
            return {name: (signature, line) for name, signature, line in index.execute(query, (kind,))}
    except (sqlite3.Error, ValueError):
        return {}


def _keep(
    index: sqlite3.Connection,
    kind: str,
    fresh: Iterable[tuple[bytes, str, str, bytes]],
    gone: Iterable[bytes],
) -> None:
    index.executemany("DELETE FROM runs WHERE name = ? AND kind = ?", [(name, kind) for name in gone])
    index.executemany("INSERT OR REPLACE INTO runs VALUES (?, ?, ?, ?)", fresh)


def change_index(path: Path, change: Callable[[sqlite3.Connection], None]) -> None:
    """Change the index at once or not at all; one that is no database is made anew."""
    if path.is_symlink():
        return
    for _ in range(2):
        try:
            with closing(opened_index(path)) as index, index:
                change(index)
        except sqlite3.OperationalError:
            # Another labrig writes it, or this account may not: the next listing tries again.
            return
        except (sqlite3.DatabaseError, ValueError):
            # What SQLite says of a spoilt file may hold bytes of it that are no text.
            with suppress(OSError):
                path.unlink()
            continue
        return


def opened_index(path: Path) -> sqlite3.Connection:
    """Open the index, made anew where it is of another format. Raises `sqlite3.Error`."""
    index = sqlite3.connect(path, timeout=_BUSY_TIMEOUT_S)
    try:
        index.execute("PRAGMA synchronous = OFF")  # a power cut may spoil it; it is a cache
        if index.execute("PRAGMA user_version").fetchone()[0] != _FORMAT:
            index.executescript(
                "DROP TABLE IF EXISTS runs; DROP TABLE IF EXISTS cells;"
                "CREATE TABLE runs (name BLOB, kind TEXT, signature TEXT, line BLOB, PRIMARY KEY (name, kind))"
                " WITHOUT ROWID;"
                "CREATE TABLE cells (path BLOB, name BLOB, cell BLOB, PRIMARY KEY (path, name)) WITHOUT ROWID;"
                f" PRAGMA user_version = {_FORMAT:d};"
            )
    except sqlite3.Error:
        index.close()
        raise
    return index
