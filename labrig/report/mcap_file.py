"""A run as an MCAP file, which Foxglove and other viewers of robot data open: an extra, `pip install 'labrig[mcap]'`.

States and events are JSON messages, pictures are `foxglove.CompressedImage`; the time of a message is when the run
started plus its rig time.
"""

import base64
import json
from collections.abc import Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
from mcap.writer import CompressionType, Writer

from labrig.errors import RecordError
from labrig.record.reader import Run

MCAP_FILE = "run.mcap"

_NS = 1_000_000_000
_TIME = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_PICTURE: Mapping[str, object] = {
    "title": "foxglove.CompressedImage",
    "type": "object",
    "properties": {
        "timestamp": _TIME,
        "frame_id": {"type": "string"},
        "data": {"type": "string", "contentEncoding": "base64"},
        "format": {"type": "string"},
    },
}


def write_mcap(run: Run, folder: Path) -> None:
    """Write a run as `folder`/run.mcap.

    Raises
    ------
    RecordError
        When a line or picture of it is damaged, or its manifest does not say when it started.
    """
    start_ns = _start_ns(run)
    with (folder / MCAP_FILE).open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="", library="labrig")
        writer.add_metadata("manifest", {"json": json.dumps(run.manifest, ensure_ascii=False)})
        _write_all(writer, "/states", _schema("labrig.State", run.states), _rows(run.states, start_ns))
        _write_all(writer, "/events", _schema("labrig.Event", run.events), _rows(run.events, start_ns))
        _write_all(
            writer, "/frames", _schema("labrig.Frame", run.frame_table), _rows(run.frame_table, start_ns)
        )
        _write_all(writer, "/camera", _PICTURE, _pictures(run, start_ns))
        writer.finish()  # type: ignore[no-untyped-call]


def _write_all(
    writer: Writer, topic: str, schema: Mapping[str, object], messages: Iterator[tuple[int, dict[str, Any]]]
) -> None:
    name = str(schema["title"])
    schema_id = writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
    channel = writer.register_channel(topic, "json", schema_id)
    for number, (time_ns, message) in enumerate(messages):
        data = json.dumps(message, ensure_ascii=False, allow_nan=False).encode()
        writer.add_message(channel, log_time=time_ns, publish_time=time_ns, data=data, sequence=number)


def _schema(title: str, table: pd.DataFrame) -> dict[str, object]:
    kinds = {
        str(name): {"type": "number"} if pd.api.types.is_numeric_dtype(table[name].dtype) else {}
        for name in table.columns
    }
    return {"title": title, "type": "object", "properties": kinds}


def _rows(table: pd.DataFrame, start_ns: int) -> Iterator[tuple[int, dict[str, Any]]]:
    for row in table.to_dict("records"):
        known = {str(key): value for key, value in row.items() if not _is_unknown(value)}
        yield start_ns + round(_NS * row["t_s"]), known


def _is_unknown(value: object) -> bool:
    return not isinstance(value, list | dict) and bool(pd.isna(value))  # type: ignore[call-overload]


def _pictures(run: Run, start_ns: int) -> Iterator[tuple[int, dict[str, Any]]]:
    for picture, t_s in zip(run.frames, run.frame_table["t_s"], strict=True):
        time_ns = start_ns + round(_NS * t_s)
        _, png = cv2.imencode(".png", np.ascontiguousarray(picture))
        yield (
            time_ns,
            {
                "timestamp": {"sec": time_ns // _NS, "nsec": time_ns % _NS},
                "frame_id": "camera",
                "data": base64.b64encode(png.tobytes()).decode(),
                "format": "png",
            },
        )


def _start_ns(run: Run) -> int:
    try:
        return round(datetime.fromisoformat(str(run.manifest["started"])).timestamp()) * _NS
    except (KeyError, ValueError) as error:
        raise RecordError(f"{run.path} does not say when it started: {error}") from error
