"""A run as an MCAP file."""

import base64
import json
from pathlib import Path

import cv2
import numpy as np
from mcap.reader import make_reader

from labrig.record.reader import open_run
from labrig.report.mcap_file import MCAP_FILE, write_mcap

FIRST = Path(__file__).parents[2] / "data" / "first-record"


def test_states_events_and_pictures_are_in_it_at_their_times(tmp_path: Path) -> None:
    """A reader of MCAP finds every state, event and picture, stamped with start and rig time, pixel for pixel."""
    run = open_run(FIRST)
    write_mcap(run, tmp_path)
    topics: dict[str, list[tuple[int, dict[str, object]]]] = {}
    with (tmp_path / MCAP_FILE).open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            topics.setdefault(channel.topic, []).append((message.log_time, json.loads(message.data)))
    assert {topic: len(messages) for topic, messages in topics.items()} == {
        "/states": len(run.states),
        "/events": len(run.events),
        "/frames": 3,
        "/camera": 3,
    }
    first_ns, last_ns = topics["/states"][0][0], topics["/states"][-1][0]
    assert last_ns - first_ns == round(1e9 * (run.states["t_s"].iloc[-1] - run.states["t_s"].iloc[0]))
    png = base64.b64decode(str(topics["/camera"][2][1]["data"]))
    read = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(read, run.frames[2])
