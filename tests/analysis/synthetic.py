"""Small runs with drawn needles, made by the record room's own Recorder, for the tests of analysis and report.

Rectified pictures of 10 px/mm: an arc of known radius leaves a sheath and bends towards -y, downwards in the
picture.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

from labrig.protocol.yaml_file import dump_yaml
from labrig.record.reader import Run, open_run
from labrig.record.writer import Recorder, opening_files
from labrig.vision.calibration_file import save_plane
from labrig.vision.plane import PlaneMap
from tests.protocol_texts import load_text
from tests.vision.renderer import Gel, Needle, Photo, Picture, flat_camera

NOW = datetime(2026, 11, 21, 9, 30, tzinfo=UTC)
PX_PER_MM, ORIGIN_PX, SIZE = 10.0, (120.0, 70.0), (480, 380)
CAMERA = replace(flat_camera(PX_PER_MM, SIZE), origin_px=ORIGIN_PX)
LENGTH_MM = 40.0
# On the way: too little for a radius, and enough.
ADVANCE_MM = (10.0, 30.0)
DRIVE = {
    "unit": "mm",
    "rpm_per_speed": 120.0,
    "drive": {"hardware_version": 0x6220, "software_version": 0x2110},
}
EXPOSURE = {"exposure_s": 0.01}
DEVICES = {"axes": {"insertion": DRIVE}, "camera": {"asked": EXPOSURE, "readback": EXPOSURE}}
PROVENANCE = {"labrig": "0.1.0", "git_commit": None, "git_dirty": False, "packages": {"numpy": "2"}}
_ANALYSIS = "{window_start_mm: 4, window_end_mm: 2, min_window_mm: 15, max_radius_sigma_mm: 0.5}"


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
) -> Picture:
    """Draw sheath and needle, turned about its axis; no needle for a radius of None."""
    steel = Needle(level=50.0, sheath_level=95.0, line=0.0, bevel=0.0, roll_rad=roll_rad, length_mm=-1.0)
    needle = steel if radius_mm is None else replace(steel, radius_mm=radius_mm, length_mm=length_mm)
    return Gel(needle, CAMERA, Photo(blur_px=0.9, noise=2.0), tracks_mm=(), bubbles=0).take(seed)


def plane_file(folder: Path) -> Path:
    """Write the plane map of the drawn pictures."""
    path = folder / "plane.json"
    save_plane(path, PlaneMap.from_scale(PX_PER_MM, ORIGIN_PX, "right", SIZE), {})
    return path


def create_record(folder: Path, name: str, text: str, plane: Path | None, **manifest: object) -> Recorder:
    """Begin the record of a protocol, with a plane map."""
    protocol = load_text(f"schema_version: 1\n{text}")
    files = opening_files(dump_yaml(protocol), None, {"plane.json": plane} if plane else {})
    told = {
        "experiment": protocol.experiment, "title": protocol.title, "started": NOW, "provenance": PROVENANCE,
    }  # fmt: skip
    return Recorder.create(folder, name, {**told, **manifest}, files)


def close_record(recorder: Recorder, exit_status: str | None = "success") -> Run:
    """Close a record, unless it is left where it stands, and open it."""
    if exit_status is not None:
        recorder.close(exit_status, "" if exit_status == "success" else "the operator said no", NOW)
    return open_run(recorder.path)


def record_sweep(folder: Path, sweep: SyntheticSweep | None = None) -> Run:
    """Record a sweep into `folder/run` and open it."""
    sweep = sweep or SyntheticSweep()
    insertions = max(1, *(len(radii) for radii in sweep.radii_mm.values()))
    specimens = dict(zip(sweep.radii_mm, sweep.gelatin_percent, strict=True))
    blocks = (f"{{name: {_quote(name)}, gelatin_percent: {percent}}}" for name, percent in specimens.items())
    text = f"""
experiment: steerability
title: {_quote(sweep.title)}
operator: {_quote(sweep.operator)}
notes: {_quote(sweep.notes)}
seed: 7
needle: {{needle_id: N1, diameter_mm: 1.2, design_radius_mm: 30}}
specimens: [{", ".join(blocks)}]
insertions_per_specimen: {insertions}
hole_spacing_mm: 10
specimen_width_mm: 240
sheath: {{depth_mm: 15, speed_mm_s: 5, diameter_mm: 2.0}}
insertion: {{length_mm: 40, speed_mm_s: 1, withdraw_speed_mm_s: 5, frame_every_mm: 20}}
analysis: {_ANALYSIS}
"""
    planned = {"seed": 7, "trials_planned": insertions * len(specimens), "devices": DEVICES}
    plane = plane_file(folder) if sweep.plane else None
    recorder = create_record(folder, "run", text, plane, operator=sweep.operator, **planned)
    trial = 0
    for name, radii_mm in sweep.radii_mm.items():
        for hole, radius_mm in enumerate(radii_mm):
            place: dict[str, object] = {"specimen": name, "gelatin_percent": specimens[name], "hole": hole}
            _record_trial(recorder, sweep, trial, place, radius_mm)
            trial += 1
    return close_record(recorder, sweep.exit_status)


def _record_trial(
    recorder: Recorder, sweep: SyntheticSweep, trial: int, place: dict[str, object], radius_mm: float
) -> None:
    t_s, specimen = 60.0 * trial, place["specimen"]
    recorder.event("trial_start", t_s, trial=trial, needle_id="N1", hole_position_mm=10.0, **place)
    drawn = None if trial in sweep.without_needle else radius_mm
    axes = {"rotation_rad": 0.0, "linear_mm": 15.0}
    recorder.frame(needle_picture(None), t_s, trial=trial, role="sheath", insertion_mm=0.0, **axes)
    for length_mm in (*ADVANCE_MM, LENGTH_MM)[: 2 if trial in sweep.without_final else 3]:
        role, seed = ("final", 100 + trial) if length_mm == LENGTH_MM else ("advance", trial)
        place = {"trial": trial, "role": role, "insertion_mm": length_mm}
        last = recorder.frame(needle_picture(drawn, length_mm, seed), t_s + length_mm, **place, **axes)
        recorder.state(t_s + length_mm, insertion_mm=length_mm, **axes)
    if trial in sweep.without_final:
        return
    if sweep.truth:
        recorder.truth(trial=trial, specimen=specimen, radius_mm=radius_mm)
    recorder.event("trial_stop", t_s + 50, trial=trial, exit_status="success", final_frame=last)


def abort_sweep(sweep: SyntheticSweep) -> SyntheticSweep:
    """Return the sweep as it is when the operator says no before the last final picture."""
    last = sum(len(radii) for radii in sweep.radii_mm.values()) - 1
    return replace(sweep, exit_status="aborted", without_final=frozenset({last}))


def record_import(folder: Path, radii_mm: Sequence[float | None]) -> Run:
    """Record loose pictures, one a radius, into `folder/import` and open it."""
    text = f"""
experiment: import
title: Loose pictures
seed: 1
needle: {{needle_id: unknown, diameter_mm: 1.2}}
sheath_diameter_mm: 2.0
scale: {{px_per_mm: 10, origin_px: [120, 70], insertion: right}}
analysis: {_ANALYSIS}
"""
    recorder = create_record(folder, "import", text, None)
    for number, radius_mm in enumerate(radii_mm):
        named = {"role": "imported", "source": f"photo{number}.jpg"}
        recorder.frame(needle_picture(radius_mm), float(number), trial=None, **named)
    return close_record(recorder)


def _quote(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"
