"""A camera calibration, recorded by the simulated world's camera."""

from pathlib import Path

from labrig.record.reader import Run
from labrig.simulation.description import WorldDescription
from labrig.simulation.world import World
from tests.analysis.synthetic import close_record, create_record


def record_calibration(
    folder: Path,
    views: int,
    *,
    hold_board: bool = True,
    gel: str = "null",
    last: Path | None = None,
    distance_mm: float | None = 116.0,
) -> Run:
    """Record a camera calibration by the simulated world's camera into `folder/calibration` and open it.

    Without `hold_board` the graph paper is photographed in place of the board: bare gel would take OpenCV's search for
    a board forty times as long. `last` is the plane map of the rig when the run begins.
    """
    distance = "null" if distance_mm is None else distance_mm
    text = f"""
experiment: camera-calibration
title: Camera
seed: 1
board: {{columns: 9, rows: 6, square_mm: 4}}
views: 12
plane: {{pitch_mm: 1, distance_mm: {distance}, origin_px: [320, 200], insertion: right, gel: {gel}}}
"""
    camera = {"readback": {"pixel_format": "GREY"}, "reported": {"focus": 0}}
    recorder = create_record(folder, "calibration", text, last, devices={"camera": camera})
    world = World(WorldDescription(), seed=1)
    for view in range(views + bool(views)):
        if hold_board and view < views:
            world.hold_board(view, 9, 6, 4.0)
        else:
            world.lay_graph_paper(1.0)
        role = "board" if view < views else "graph-paper"
        recorder.frame(world.picture(), float(view), trial=None, role=role)
    return close_record(recorder, "success" if views else "aborted")
