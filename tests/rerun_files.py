"""Reading a rerun file."""

from pathlib import Path
from typing import Any

import rerun as rr


def read_view(path: Path) -> dict[str, list[Any]]:
    """Return the entities of a file: the values of a curve, a JPEG, or labels and texts, in order of rig time."""
    found: dict[str, list[tuple[Any, Any]]] = {}
    for chunk in rr.chunk.RrdReader(path).stream():
        batch = chunk.to_record_batch()
        values = found.setdefault(_plain(str(chunk.entity_path)), [])
        told = [
            name for name in batch.schema.names if name.endswith((":scalars", ":labels", ":text", ":blob"))
        ]
        if told and "rig time" in batch.schema.names:
            times = batch.column("rig time").cast("int64").to_pylist()
            values += [
                (t_ns, row[0])
                for t_ns, row in zip(times, batch.column(told[0]).to_pylist(), strict=True)
                if row
            ]
    return {
        place: [value for _, value in sorted(values, key=lambda pair: pair[0])]
        for place, values in found.items()
    }


def _plain(entity_path: str) -> str:
    return entity_path.replace("\\", "")
