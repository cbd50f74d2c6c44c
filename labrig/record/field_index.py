"""The fields of many runs in the index, by field: a search reads those that it asks for, and not all of every run.

A run of a sweep has two hundred fields, and a condition names two or three. So each field of each run is a cell of its
own, found by the field's path. The row of a run names its shape, which is the list of the paths that it has; shapes
are kept once. A cell that its shape promises and that is not there, or whose CRC-32 does not fit path, run, signature
and values together, makes the run be read again.
"""

import hashlib
import json
import os
import sqlite3
import zlib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from labrig.record.condition import Fields, Value
from labrig.record.json_lines import encode_line, encode_value
from labrig.record.run_index import INDEX_FILE, cached_rows, change_index, intact_row, opened_index

_RUN, _SHAPE = "fields", "shape"
_CRC_BYTES = 4

Paths = frozenset[str]


@dataclass(frozen=True)
class _Kept:
    """What the index says of a run: its key, the paths of its fields, and the checksum that its cells go on from."""

    run: bytes
    paths: Paths
    seed: int


def remembered_fields(
    runs_dir: Path,
    signatures: Mapping[str, str],
    read: Callable[[str], Fields],
    pick: Callable[[Paths], Collection[str]],
) -> tuple[dict[str, dict[str, Sequence[Value]]], Paths]:
    """Return the fields of each run that are asked for, from the index where the run's files have not changed since.

    Parameters
    ----------
    signatures : Mapping
        Name of the run's folder to the signature of the files that `read` looks at.
    read : callable
        Takes a name and returns all fields of the run.
    pick : callable
        Takes the paths that there are and returns those that are asked for.

    Returns
    -------
    fields : dict
        Name of the run to those of its fields.
    known : frozenset of str
        The paths that there are.
    """
    index = runs_dir / INDEX_FILE
    rows = cached_rows(index, _RUN)
    kept = _kept(rows, cached_rows(index, _SHAPE), signatures)
    fresh = {name: read(name) for name in signatures if name not in kept}
    known = frozenset().union(*{one.paths for one in kept.values()}, *fresh.values())
    picked = pick(known)
    fields, spoilt = _cells(index, kept, picked)
    fresh |= {name: read(name) for name in spoilt}
    gone = rows.keys() - {os.fsencode(name) for name in signatures}
    if fresh or gone:
        change_index(index, lambda opened: _keep(opened, signatures, fresh, gone))
    for name, all_of_them in fresh.items():
        # As the index will say them the next time: an infinite number is none, for example.
        fields[name] = {
            path: json.loads(encode_value(values)) for path, values in all_of_them.items() if path in picked
        }
    return fields, known


def _kept(
    rows: Mapping[bytes, tuple[str, bytes]],
    shapes: Mapping[bytes, tuple[str, bytes]],
    signatures: Mapping[str, str],
) -> dict[str, _Kept]:
    """Return the runs of which the index has what their files say now."""
    paths_of = {}
    for shape, row in shapes.items():
        found = intact_row(row, "")
        if found is not None and _shape(paths := [str(path) for path in found["paths"]]) == shape:
            paths_of[shape] = frozenset(paths)
    kept = {}
    for name, signature in signatures.items():
        run = os.fsencode(name)
        noted, line = rows.get(run, ("", b""))
        seed = _seed(run, signature)
        shape = line[_CRC_BYTES:]
        if noted == signature and shape in paths_of and line[:_CRC_BYTES] == _checked(seed, shape):
            kept[name] = _Kept(run, paths_of[shape], seed)
    return kept


def _cells(
    path: Path, kept: Mapping[str, _Kept], picked: Iterable[str]
) -> tuple[dict[str, dict[str, Sequence[Value]]], set[str]]:
    """Return the picked fields of the runs that are kept, and the runs of which a cell is lost or spoilt."""
    fields: dict[str, dict[str, Sequence[Value]]] = {name: {} for name in kept}
    spoilt: set[str] = set()
    parsed: dict[bytes, Sequence[Value]] = {}
    for field in picked:
        cells, key = _column(path, field), zlib.crc32(_key(field))
        for name, one in kept.items():
            if field not in one.paths:
                continue
            cell = cells.get(one.run, b"")
            body = cell[_CRC_BYTES:]
            if not body or cell[:_CRC_BYTES] != _checked(one.seed ^ key, body):
                spoilt.add(name)
                continue
            if body not in parsed:
                parsed[body] = json.loads(body)
            fields[name][field] = parsed[body]
    return fields, spoilt


def _column(path: Path, field: str) -> dict[bytes, bytes]:
    try:
        with closing(opened_index(path)) as index:
            return dict(index.execute("SELECT name, cell FROM cells WHERE path = ?", (_key(field),)))
    except (sqlite3.Error, ValueError):
        return {}


def _keep(
    index: sqlite3.Connection,
    signatures: Mapping[str, str],
    fresh: Mapping[str, Fields],
    gone: Iterable[bytes],
) -> None:
    """Write the runs that were read, and take out those that are gone; what was there of a run goes first."""
    index.execute("CREATE TEMP TABLE changed (name BLOB PRIMARY KEY)")
    index.executemany(
        "INSERT INTO changed VALUES (?)", [(name,) for name in (*gone, *map(os.fsencode, fresh))]
    )
    index.execute("DELETE FROM cells WHERE name IN changed")
    index.execute("DELETE FROM runs WHERE kind = ? AND name IN changed", (_RUN,))
    rows: dict[tuple[bytes, str], tuple[bytes, str, str, bytes]] = {}
    cells = []
    for name, fields in fresh.items():
        shape, run, signature = _shape(fields), os.fsencode(name), signatures[name]
        rows[shape, _SHAPE] = (shape, _SHAPE, "", encode_line({"paths": sorted(fields)}))
        seed = _seed(run, signature)
        rows[run, _RUN] = (run, _RUN, signature, _checked(seed, shape) + shape)
        for path, values in fields.items():
            body = encode_value(values)
            key = _key(path)
            cells.append((key, run, _checked(seed ^ zlib.crc32(key), body) + body))
    index.executemany("INSERT OR REPLACE INTO runs VALUES (?, ?, ?, ?)", rows.values())
    index.executemany("INSERT OR REPLACE INTO cells VALUES (?, ?, ?)", sorted(cells))


def _shape(paths: Iterable[str]) -> bytes:
    """Return the name of a shape: a hash of its paths in alphabetical order."""
    return hashlib.sha256(b"\0".join(map(_key, sorted(paths)))).hexdigest()[:32].encode()


def _key(path: str) -> bytes:
    return path.encode("utf-8", "surrogatepass")


def _seed(run: bytes, signature: str) -> int:
    return zlib.crc32(b"%s/%s" % (run, signature.encode()))


def _checked(seed: int, body: bytes) -> bytes:
    return zlib.crc32(body, seed).to_bytes(_CRC_BYTES, "big")
