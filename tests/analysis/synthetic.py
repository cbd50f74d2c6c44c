"""Small runs with drawn needles, made by the record room's own Recorder, for the tests of analysis and report.

Rectified pictures of 10 px/mm: an arc of known radius leaves a sheath and bends towards -y, downwards in the
picture.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from labrig.protocol.yaml_file import dump_yaml
from labrig.record.reader import Run, open_run
from labrig.record.writer import Recorder, opening_files
from labrig.simulation.description import WorldDescription
from labrig.simulation.world import World
from labrig.vision.calibration_file import save_plane
from labrig.vision.plane import PlaneMap
from tests.protocol_texts import load_text

NOW = datetime(2026, 11, 21, 9, 30, tzinfo=UTC)
PX_PER_MM = 10.0
ORIGIN_PX = (120.0, 70.0)
SIZE = (480, 380)
LENGTH_MM = 40.0
# On the way: too little for a radius, and enough.
ADVANCE_MM = (10.0, 30.0)
DRIVE = {
    "unit": "mm",
    "rpm_per_speed": 120.0,
    "drive": {"hardware_version": 0x6220, "software_version": 0x2110},
}
PROVENANCE = {"labrig": "0.1.0", "git_commit": None, "git_dirty": False, "packages": {"numpy": "2"}}

_PROTOCOL = """
schema_version: 1
experiment: steerability
title: {title}
operator: {operator}
notes: {notes}
seed: 7
needle: {{needle_id: N1, diameter_mm: 1.2, design_radius_mm: 30}}
specimens: [{specimens}]
insertions_per_specimen: {insertions}
hole_spacing_mm: 10
specimen_width_mm: 240
sheath: {{depth_mm: 15, speed_mm_s: 5, diameter_mm: 2.0}}
insertion: {{length_mm: 40, speed_mm_s: 1, withdraw_speed_mm_s: 5, frame_every_mm: 20}}
analysis: {{window_start_mm: 4, window_end_mm: 2, min_window_mm: 15, max_radius_sigma_mm: 0.5}}
"""


@dataclass(frozen=True)
class SyntheticSweep:
    """What is recorded: the radii of each gel, and the words of the people around it."""

    radii_mm: dict[str, tuple[float, ...]] = field(
        default_factory=lambda: {"gel A": (28.0, 28.6), "gel B": (27.0, 27.4)}
    )
    gelatin_percent: tuple[float, ...] = (10.0, 19.0)
    title: str = "Two gels"
    operator: str = "somebody"
    notes: str = "none"
    truth: bool = True
    exit_status: str | None = "success"
    without_needle: frozenset[int] = frozenset()
    without_final: frozenset[int] = frozenset()
    plane: bool = True


def needle_picture(
    radius_mm: float | None, length_mm: float = LENGTH_MM, seed: int = 0, roll_rad: float = 0.0
) -> NDArray[np.uint8]:
    """Draw sheath and needle, turned about its axis; no needle for a radius of None."""
    width, height = SIZE
    image = np.full((height, width), 165, np.uint8)
    u0, v0 = ORIGIN_PX
    if radius_mm is not None:
        angle = np.linspace(0.0, length_mm / radius_mm, 200)
        z, depth = radius_mm * np.sin(angle), radius_mm * (1.0 - np.cos(angle))
        points = np.column_stack((u0 + PX_PER_MM * z, v0 + PX_PER_MM * depth * np.cos(roll_rad)))
        cv2.polylines(image, [np.round(points * 16).astype(np.int32)], False, 50, 12, cv2.LINE_AA, 4)
    cv2.rectangle(image, (0, int(v0) - 10), (int(u0), int(v0) + 10), 95, -1)
    noise = np.random.default_rng(seed).normal(0.0, 2.0, image.shape)
    return np.clip(cv2.GaussianBlur(image, (0, 0), 0.9) + noise, 0, 255).round().astype(np.uint8)


def plane_file(folder: Path) -> Path:
    """Write the plane map of the drawn pictures."""
    path = folder / "plane.json"
    save_plane(path, PlaneMap.from_scale(PX_PER_MM, ORIGIN_PX, "right", SIZE), {})
    return path


def record_sweep(folder: Path, sweep: SyntheticSweep | None = None) -> Run:
    """Record a sweep into `folder/run` and open it."""
    sweep = sweep or SyntheticSweep()
    insertions = max(1, *(len(radii) for radii in sweep.radii_mm.values()))
    specimens = dict(zip(sweep.radii_mm, sweep.gelatin_percent, strict=True))
    protocol = load_text(
        _PROTOCOL.format(
            title=_quote(sweep.title),
            operator=_quote(sweep.operator),
            notes=_quote(sweep.notes),
            specimens=", ".join(
                f"{{name: {_quote(name)}, gelatin_percent: {percent}}}" for name, percent in specimens.items()
            ),
            insertions=insertions,
        )
    )
    manifest = {
        "experiment": "steerability", "started": NOW, "title": sweep.title, "operator": sweep.operator, "seed": 7,
        "trials_planned": insertions * len(specimens), "provenance": PROVENANCE,
        "devices": {
            "axes": {"insertion": DRIVE},
            "camera": {"asked": {"exposure_s": 0.01}, "readback": {"exposure_s": 0.01}},
        },
    }  # fmt: skip
    calibration = {"plane.json": plane_file(folder)} if sweep.plane else {}
    recorder = Recorder.create(folder, "run", manifest, opening_files(dump_yaml(protocol), None, calibration))
    trial = 0
    for name, percent in specimens.items():
        for hole, radius_mm in enumerate(sweep.radii_mm[name]):
            place: dict[str, object] = {"specimen": name, "gelatin_percent": percent, "hole": hole}
            _record_trial(recorder, sweep, trial, place, radius_mm)
            trial += 1
    if sweep.exit_status is not None:
        recorder.close(
            sweep.exit_status, "" if sweep.exit_status == "success" else "the operator said no", NOW
        )
    return open_run(recorder.path)


def _record_trial(
    recorder: Recorder, sweep: SyntheticSweep, trial: int, place: dict[str, object], radius_mm: float
) -> None:
    t_s = 60.0 * trial
    recorder.event("trial_start", t_s, trial=trial, needle_id="N1", hole_position_mm=10.0, **place)
    drawn = None if trial in sweep.without_needle else radius_mm
    axes = {"rotation_rad": 0.0, "linear_mm": 15.0}
    recorder.frame(needle_picture(None), t_s, trial=trial, role="sheath", insertion_mm=0.0, **axes)
    for length_mm in ADVANCE_MM:
        picture = needle_picture(drawn, length_mm, trial)
        recorder.frame(picture, t_s + length_mm, trial=trial, role="advance", insertion_mm=length_mm, **axes)
        recorder.state(t_s + length_mm, insertion_mm=length_mm, **axes)
    if trial in sweep.without_final:
        return
    picture = needle_picture(drawn, LENGTH_MM, 100 + trial)
    final = recorder.frame(picture, t_s + 40, trial=trial, role="final", insertion_mm=40.0, **axes)
    recorder.state(t_s + 40, insertion_mm=40.0, **axes)
    if sweep.truth:
        recorder.truth(trial=trial, specimen=place["specimen"], radius_mm=radius_mm)
    recorder.event("trial_stop", t_s + 50, trial=trial, exit_status="success", final_frame=final)


def record_import(folder: Path, radii_mm: Sequence[float | None]) -> Run:
    """Record loose pictures, one a radius, into `folder/import` and open it."""
    text = """
schema_version: 1
experiment: import
title: Loose pictures
seed: 1
needle: {needle_id: unknown, diameter_mm: 1.2}
sheath_diameter_mm: 2.0
scale: {px_per_mm: 10, origin_px: [120, 70], insertion: right}
analysis: {window_start_mm: 4, window_end_mm: 2, min_window_mm: 15, max_radius_sigma_mm: 0.5}
"""
    protocol = load_text(text)
    manifest = {"experiment": "import", "started": NOW, "title": "Loose pictures", "provenance": PROVENANCE}
    recorder = Recorder.create(folder, "import", manifest, opening_files(dump_yaml(protocol)))
    for number, radius_mm in enumerate(radii_mm):
        recorder.frame(
            needle_picture(radius_mm), float(number), trial=None, role="imported", source=f"photo{number}.jpg"
        )
    recorder.close("success", "", NOW)
    return open_run(recorder.path)


def record_roll_zero(folder: Path, zero_rad: float, without_needle: frozenset[int] = frozenset()) -> Run:
    """Record short insertions at six rolls of a needle that bends towards -y at `zero_rad`, and open the run."""
    text = """
schema_version: 1
experiment: roll-zero
title: Roll zero
seed: 1
needle: {needle_id: N1, diameter_mm: 1.2, design_radius_mm: 28}
sheath: {depth_mm: 15, speed_mm_s: 5, diameter_mm: 2.0}
insertion: {speed_mm_s: 1, withdraw_speed_mm_s: 5}
roll_zero: {specimen: {name: block, gelatin_percent: 13}, rolls: 6, length_mm: 14, max_sd_deg: 3}
"""
    manifest = {"experiment": "roll-zero", "started": NOW, "title": "Roll zero", "provenance": PROVENANCE}
    protocol = dump_yaml(load_text(text))
    recorder = Recorder.create(
        folder, "roll-zero", manifest, opening_files(protocol, None, {"plane.json": plane_file(folder)})
    )
    for step in range(6):
        roll_rad = step * np.pi / 3
        drawn = None if step in without_needle else 28.0
        picture = needle_picture(drawn, 14.0, step, roll_rad - zero_rad)
        place = {"insertion_mm": 14.0, "rotation_rad": roll_rad, "linear_mm": 15.0}
        recorder.frame(picture, 60.0 * step, trial=None, role="roll-zero", **place)
    recorder.close("success", "", NOW)
    return open_run(recorder.path)


def abort_sweep(sweep: SyntheticSweep) -> SyntheticSweep:
    """Return the sweep as it is when the operator says no before the last final picture."""
    last = sum(len(radii) for radii in sweep.radii_mm.values()) - 1
    return replace(sweep, exit_status="aborted", without_final=frozenset({last}))


def _quote(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


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
schema_version: 1
experiment: camera-calibration
title: Camera
seed: 1
board: {{columns: 9, rows: 6, square_mm: 4}}
views: 12
plane: {{pitch_mm: 1, distance_mm: {distance}, origin_px: [320, 200], insertion: right, gel: {gel}}}
"""
    world = World(WorldDescription(), seed=1)
    manifest = {
        "experiment": "camera-calibration",
        "started": NOW,
        "title": "Camera",
        "provenance": PROVENANCE,
        "devices": {"camera": {"readback": {"pixel_format": "GREY"}, "reported": {"focus": 0}}},
    }
    recorder = Recorder.create(
        folder,
        "calibration",
        manifest,
        opening_files(dump_yaml(load_text(text)), None, {} if last is None else {"plane.json": last}),
    )
    for view in range(views):
        if hold_board:
            world.hold_board(view, 9, 6, 4.0)
        else:
            world.lay_graph_paper(1.0)
        recorder.frame(world.picture(), float(view), trial=None, role="board")
    if views:
        world.lay_graph_paper(1.0)
        recorder.frame(world.picture(), float(views), trial=None, role="graph-paper")
    recorder.close("success" if views else "aborted", "" if views else "the operator said no", NOW)
    return open_run(recorder.path)
