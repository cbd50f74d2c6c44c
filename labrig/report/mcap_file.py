"""Export a run as an MCAP file for Foxglove and other viewers of robot data; needs the extra `mcap` of labrig.

States and events are JSON messages, pictures are `foxglove.CompressedImage`. The time of a message is the start of the
run plus its rig time.
"""

import base64
import json
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.writer import CompressionType, Writer

from labrig.durable import disk_errors
from labrig.errors import RecordError
from labrig.record.reader import Run
from labrig.record.tables import add_axis_units

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
        When a line or picture is damaged, or the manifest has no start time.
    DiskError
        When it cannot be written.
    """
    start_ns = _read_start_ns(run)
    with disk_errors(folder / MCAP_FILE), (folder / MCAP_FILE).open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="", library="labrig")
        writer.add_metadata("manifest", {"json": json.dumps(run.manifest, ensure_ascii=False)})
        events = [add_axis_units(event) for event in run.lines("events")]
        _write_lines(writer, "/states", "labrig.State", run.lines("states"), start_ns)
        _write_lines(writer, "/events", "labrig.Event", events, start_ns)
        _write_lines(writer, "/frames", "labrig.Frame", run.lines("frames"), start_ns)
        _write_all(writer, "/camera", _PICTURE, _list_pictures(run, start_ns))
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


def _write_lines(
    writer: Writer, topic: str, title: str, lines: Sequence[Mapping[str, Any]], start_ns: int
) -> None:
    """Write lines of a record, each at its time; unknown values are left out."""
    known = [{name: value for name, value in line.items() if value is not None} for line in lines]
    values: dict[str, list[object]] = {}
    for line in known:
        for name, value in line.items():
            values.setdefault(name, []).append(value)
    kinds = {
        name: {"type": "number"} if all(isinstance(value, int | float) for value in column) else {}
        for name, column in values.items()
    }
    messages = ((start_ns + round(_NS * line["t_s"]), line) for line in known)
    _write_all(writer, topic, {"title": title, "type": "object", "properties": kinds}, messages)


def _list_pictures(run: Run, start_ns: int) -> Iterator[tuple[int, dict[str, Any]]]:
    for picture, t_s in zip(run.frames, (line.t_s for line in run.frame_lines), strict=True):
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


def _read_start_ns(run: Run) -> int:
    try:
        return round(datetime.fromisoformat(str(run.manifest["started"])).timestamp()) * _NS
    except (KeyError, ValueError) as error:
        raise RecordError(f"{run.path} does not say when it started: {error}") from error
