"""A cache of the fields of all runs in a folder, in SQLite; if lost, stale or corrupt it is made again.

`runs` has a row for each run: the signature of the files behind its summary (time, size and inode), the summary as a
CRC line, and the signature of the files behind its leaves. `leaves` has a row for each field of a run: its path, and
its values as a JSON list. An entry whose signature does not fit is read again; a file that is no database is replaced.
If the folder cannot be written, or another labrig writes it, a copy in memory gives the same answer.
"""

import json
import os
import sqlite3
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import closing, suppress
from functools import lru_cache
from pathlib import Path
from typing import TypeAlias, TypeVar

from labrig.record.condition import Condition, find_paths
from labrig.record.json_lines import decode_line, decode_lines, encode_line

INDEX_FILE = ".catalogue.sqlite3"
NO_FILE = "-"
"""The signature of a missing file."""

_FORMAT = 4
_BUSY_TIMEOUT_S = 1.0
_MEMORY = ":memory:"
_TABLES = f"""
DROP TABLE IF EXISTS runs; DROP TABLE IF EXISTS cells; DROP TABLE IF EXISTS paths; DROP TABLE IF EXISTS leaves;
CREATE TABLE runs (run INTEGER PRIMARY KEY, name BLOB UNIQUE, signature TEXT, line BLOB, leaves_signature TEXT);
CREATE TABLE paths (path INTEGER PRIMARY KEY, text TEXT UNIQUE);
CREATE TABLE leaves (path INTEGER, run INTEGER, leaf TEXT, PRIMARY KEY (path, run)) WITHOUT ROWID;
PRAGMA user_version = {_FORMAT:d};
"""
_KNOWN = "SELECT text, path FROM paths WHERE EXISTS (SELECT 1 FROM leaves WHERE leaves.path = paths.path)"
_ASKED = """
CREATE TEMP TABLE asked (name TEXT, parts INTEGER, path INTEGER, PRIMARY KEY (name, parts, path)) WITHOUT ROWID
"""
# Of the paths that a name matches, those with the fewest parts in the run count.
_HELD = """
CREATE TEMP TABLE held AS SELECT run, name, leaf FROM asked JOIN leaves USING (path) WHERE NOT EXISTS (
    SELECT 1 FROM asked AS other JOIN leaves AS nearer USING (path)
    WHERE other.name = asked.name AND other.parts < asked.parts AND nearer.run = leaves.run
) ORDER BY run, path
"""

Value: TypeAlias = str | int | float | bool | None
Fields: TypeAlias = Mapping[str, Sequence[Value]]
"""Values by dotted path, such as `protocol.specimens.gelatin_percent`."""
Row: TypeAlias = dict[str, object]
ShareDone: TypeAlias = Callable[[float], None]
"""Is told the share of the runs to be read that have been, 0 to 1; not called if none has to be."""
_Answer = TypeVar("_Answer")


class RunIndex:
    """The open index of a folder of runs, from `ask_index`."""

    def __init__(self, index: sqlite3.Connection) -> None:
        self._index = index

    def summaries(
        self,
        signatures: Mapping[str, str],
        read: Callable[[str], Mapping[str, object]],
        progress: ShareDone | None = None,
    ) -> dict[str, Row]:
        """Return the summary of each run; those whose files have changed come from `read`.

        Parameters
        ----------
        signatures : Mapping
            Name of the run's folder to the signature of the files that `read` reads.
        read : callable
            Takes a name and returns the summary in types of JSON.
        progress : callable or None
            Told how much of that is done.
        """
        kept = {
            os.fsdecode(name): (signature, line)
            for name, signature, line in self._index.execute("SELECT name, signature, line FROM runs")
        }
        gone = [os.fsencode(name) for name in kept if name not in signatures]
        intact = _read_intact_rows(kept, signatures)
        rows, fresh = {}, []
        for number, (name, signature) in enumerate(signatures.items(), start=1):
            row = intact.get(name)
            if row is None:
                _report(progress, number, len(signatures))
                line = encode_line(read(name))
                fresh.append((os.fsencode(name), signature, line))
                row = decode_line(line[:-1])
            rows[name] = row
        if fresh or gone:
            with self._index:
                self._forget_leaves(gone)
                self._index.executemany("DELETE FROM runs WHERE name = ?", [(name,) for name in gone])
                self._index.executemany(
                    "INSERT INTO runs (name, signature, line) VALUES (?, ?, ?) ON CONFLICT (name)"
                    " DO UPDATE SET signature = excluded.signature, line = excluded.line",
                    fresh,
                )
        return rows

    def refresh_leaves(
        self,
        signatures: Mapping[str, str],
        read: Callable[[str], Fields],
        progress: ShareDone | None = None,
    ) -> None:
        """Update the leaves of runs whose summaries have been read; parameters as for these."""
        kept = dict(self._index.execute("SELECT name, leaves_signature FROM runs"))
        names = {os.fsencode(name): name for name in signatures}
        stale = {key: name for key, name in names.items() if kept.get(key) != signatures[name]}
        if not stale:
            return
        fields = {}
        for number, (key, name) in enumerate(stale.items(), start=1):
            fields[key] = read(name)
            _report(progress, number, len(stale))
        paths = dict.fromkeys(path for leaves in fields.values() for path in leaves)
        with self._index:
            self._forget_leaves(key for key in stale if kept.get(key) is not None)
            # Another labrig may have deleted the row because the run was gone.
            self._index.executemany("INSERT OR IGNORE INTO runs (name) VALUES (?)", [(key,) for key in stale])
            self._index.executemany(
                "INSERT OR IGNORE INTO paths (text) VALUES (?)", [(path,) for path in paths]
            )
            path_numbers = dict(self._index.execute("SELECT text, path FROM paths"))
            run_numbers = dict(self._index.execute("SELECT name, run FROM runs"))
            self._index.executemany(
                "INSERT INTO leaves VALUES (?, ?, ?)",
                sorted(
                    (path_numbers[path], run_numbers[key], _encode_leaf(*values))
                    for key, leaves in fields.items()
                    for path, values in leaves.items()
                ),
            )
            self._index.executemany(
                "UPDATE runs SET leaves_signature = ? WHERE name = ?",
                [(signatures[name], key) for key, name in stale.items()],
            )

    def known_paths(self) -> dict[str, int]:
        """Return the paths of all fields, with their numbers."""
        return dict(self._index.execute(_KNOWN))

    def find(
        self, names: Collection[str], condition: Condition | None
    ) -> dict[str, dict[str, tuple[Value, ...]]]:
        """Return the runs that fit a condition with their values under each name; call it once for an index."""
        known = self.known_paths()
        self._index.execute(_ASKED)
        self._index.executemany(
            "INSERT INTO asked VALUES (?, ?, ?)",
            [
                (name, 0 if path == name else path.count("."), known[path])
                for name in dict.fromkeys(names)
                for path in find_paths(name, known)
            ],
        )
        self._index.execute(_HELD)
        held: dict[tuple[int, str], tuple[Value, ...]] = {}
        for run, name, leaf in self._index.execute("SELECT run, name, leaf FROM held"):
            values, others = _decode_leaf(leaf), held.get((run, name))
            held[run, name] = values if others is None else tuple(dict.fromkeys(others + values))
        sql, parameters = ("TRUE", ()) if condition is None else (condition.sql, condition.parameters)
        # Typed text is only in the parameters; the expression consists of this package's own words.
        fitting = self._index.execute(f"SELECT run, name FROM runs WHERE {sql}", parameters)  # noqa: S608
        return {
            os.fsdecode(folder): {name: held.get((run, name), ()) for name in names}
            for run, folder in fitting
        }

    def _forget_leaves(self, names: Iterable[bytes]) -> None:
        self._index.executemany(
            "DELETE FROM leaves WHERE path IN (SELECT path FROM paths) AND run = (SELECT run FROM runs WHERE name = ?)",
            [(name,) for name in names],
        )


def _report(progress: ShareDone | None, done: int, total: int) -> None:
    if progress is not None:
        progress(done / total)


def ask_index(runs_dir: Path, ask: Callable[[RunIndex], _Answer]) -> _Answer:
    """Return the answer of `ask` from the index of a folder; a corrupt index is made again and asked again."""
    path = runs_dir / INDEX_FILE
    is_unfit = path.is_symlink() or (path.exists() and not path.is_file())  # SQLite would wait for a pipe
    places = () if is_unfit else ((str(path), None), (str(path), None), (_MEMORY, path))
    for place, source in places:
        try:
            with closing(_open_index(place, source)) as index:
                return ask(RunIndex(index))
        except sqlite3.OperationalError:
            # Another labrig is writing it, or this account may not.
            continue
        except (sqlite3.DatabaseError, ValueError, TypeError):
            # The file is corrupt; it, and a message of SQLite about it, may hold bytes that are no text.
            with suppress(OSError):
                path.unlink()
    with closing(_open_index(_MEMORY)) as index:
        return ask(RunIndex(index))


def _open_index(place: str, source: Path | None = None) -> sqlite3.Connection:
    """Open the index, or a copy of a source; another format is replaced. Raises `sqlite3.Error`."""
    index = sqlite3.connect(place, timeout=_BUSY_TIMEOUT_S)
    try:
        if source is not None:
            with closing(
                sqlite3.connect(f"{source.absolute().as_uri()}?mode=ro", timeout=0, uri=True)
            ) as original:
                # Without this, backup would wait for a lock forever.
                original.executescript("BEGIN; SELECT name FROM sqlite_master")
                original.backup(index)
        index.execute("PRAGMA synchronous = OFF")  # a power cut may corrupt it; it is a cache
        if index.execute("PRAGMA user_version").fetchone()[0] != _FORMAT:
            index.executescript(_TABLES)
        index.create_function("shown", 2, _format_value, deterministic=True)
        index.create_function("casefold", 1, str.casefold, deterministic=True)
    except sqlite3.Error:
        index.close()
        raise
    return index


@lru_cache(maxsize=100_000, typed=True)  # most values occur in other runs too
def _encode_leaf(*values: Value) -> str:
    return json.dumps(values, ensure_ascii=False)


@lru_cache(maxsize=100_000)
def _decode_leaf(text: str) -> tuple[Value, ...]:
    """Return the values of a leaf, each once."""
    return tuple(dict.fromkeys(json.loads(text)))


def _format_value(value: Value, kind: str) -> str:
    """Return a value of a leaf as it is written in a condition; `kind` is the type from SQLite's json_each."""
    return kind if kind in {"null", "true", "false"} else str(value)


def _read_intact_rows(
    kept: Mapping[str, tuple[str, bytes]], signatures: Mapping[str, str]
) -> dict[str, Row | None]:
    """Return the summaries whose signatures fit; None for one whose checksum does not."""
    fitting = {
        name: kept[name][1]
        for name, signature in signatures.items()
        if name in kept and kept[name][0] == signature
    }
    try:
        rows = decode_lines([line[:-1] for line in fitting.values()])
    except TypeError:  # a corrupt index may hold anything
        return {}
    return dict(zip(fitting, rows, strict=True))


def signature_of(run: str, files: Iterable[str]) -> str:
    """Return a text that changes when one of the files of a run changes; `run` is its folder."""
    parts = []
    for file in files:
        try:
            found = os.lstat(f"{run}/{file}")
        except OSError:
            parts.append(NO_FILE)
            continue
        parts.append(f"{found.st_mtime_ns}.{found.st_size}.{found.st_ino}")
    return " ".join(parts)
