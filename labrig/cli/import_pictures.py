"""`labrig import`: turns folders of pictures into runs."""

import hashlib
import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from labrig.cli.mapping import load_plane_map
from labrig.cli.output import say
from labrig.devices.clocks import SystemClock
from labrig.errors import InputError, PictureError
from labrig.experiments.imported_pictures.events import PictureRefused
from labrig.experiments.imported_pictures.protocol import ImportProtocol
from labrig.experiments.shared.needle_events import NeedleRole
from labrig.input_file import read_file
from labrig.protocol.model import Direction
from labrig.protocol.yaml_file import dump_yaml, validate_values
from labrig.record.json_lines import plain_text
from labrig.record.manifest import read_checksum
from labrig.record.provenance import collect_provenance
from labrig.record.writer import Recorder, RunFiles, create_under_free_name
from labrig.vision.picture import MAX_PICTURE_BYTES, PICTURE_SUFFIXES, number_order, read_picture

_ROLL_SD_DEG = 2.0
"""Of a bevel that was set by eye; `labrig reanalyze --set analysis.roll_sd_deg=` says otherwise."""


@dataclass(frozen=True)
class ImportOrder:
    """What is known of the pictures, and the folder for the runs."""

    px_per_mm: float | None
    origin_px: tuple[float, float] | None
    insertion: Direction | None
    intrinsics: Path | None
    plane: Path | None
    needle_diameter_mm: float
    sheath_diameter_mm: float | None
    runs_dir: Path
    command_line: tuple[str, ...]


def find_picture_folders(folder: Path) -> list[Path]:
    """Return the folder itself, if it holds pictures, and each folder directly in it that does, in order.

    Raises
    ------
    InputError
        When there is no such folder, or no picture in it.
    """
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder", "name a folder of pictures")
    candidates = [folder, *sorted(path for path in folder.iterdir() if path.is_dir())]
    found = [candidate for candidate in candidates if _find_pictures(candidate)]
    if not found:
        endings = " ".join(sorted(PICTURE_SUFFIXES))
        raise InputError(f"no picture in {folder} or in a folder of it", f"pictures end in {endings}")
    return found


def import_folder(folder: Path, order: ImportOrder) -> dict[str, object]:
    """Copy the pictures of one folder, in the order of the numbers in their names, into a new run.

    A picture that cannot be read is named in the run's events and left out.

    Raises
    ------
    InputError
        When no picture of the folder can be read, or the scale is not given.
    """
    load_plane_map(order.intrinsics, order.plane, order.px_per_mm, order.origin_px, order.insertion)
    clock = SystemClock()
    started = clock.utc()
    protocol = _make_protocol(folder, order)
    pictures = _require_readable(folder)
    create = partial(
        Recorder.create,
        order.runs_dir,
        manifest={
            "experiment": protocol.experiment,
            "title": protocol.title,
            "operator": protocol.operator,
            "seed": protocol.seed,
            "started": started.isoformat(timespec="seconds"),
            "trials_planned": 0,
            "provenance": collect_provenance(order.command_line),
            "protocol": protocol.model_dump(mode="json"),
        },
        files=RunFiles(dump_yaml(protocol), calibration=_find_kept_files(order)),
    )
    recorder = create_under_free_name(started, _make_run_name(folder), create)
    refused = _copy_pictures(pictures, recorder)
    reason = f"{len(refused)} of {len(pictures)} pictures could not be read" if refused else ""
    recorder.close("success", reason, clock.utc())
    checksum = read_checksum(recorder.path)
    return {"run": str(recorder.path), "ok": not refused, "reason": reason or None, "checksum": checksum}


def _find_kept_files(order: ImportOrder) -> dict[str, Path]:
    """Return the files of the calibration by their names in a record."""
    calibration = (("intrinsics.json", order.intrinsics), ("plane.json", order.plane))
    return {name: path for name, path in calibration if path is not None}


def _copy_pictures(pictures: list[Path], recorder: Recorder) -> list[Path]:
    """Record every picture that can be read, and an event for every picture that cannot."""
    refused = []
    for number, path in enumerate(pictures):
        try:
            image = read_picture(path)
        except PictureError as error:
            refused.append(path)
            say(f"left out: {error.message}")
            refusal = PictureRefused(source=plain_text(path.name), reason=plain_text(error.message))
            recorder.record_event(refusal, float(number))
            continue
        recorder.frame(
            image,
            float(number),
            trial=None,
            role=NeedleRole.IMPORTED,
            source=plain_text(path.name),
            source_sha256=hashlib.sha256(read_file(path, MAX_PICTURE_BYTES)).hexdigest(),
        )
    return refused


def _require_readable(folder: Path) -> list[Path]:
    """Return the pictures of a folder, of which at least one can be read."""
    pictures = _find_pictures(folder)
    refusals = []
    for path in pictures:
        try:
            read_picture(path)
        except PictureError as error:
            refusals.append(error)
            continue
        return pictures
    raise InputError(f"no picture in {folder} can be read: {refusals[0].message}", refusals[0].hint)


def _make_protocol(folder: Path, order: ImportOrder) -> ImportProtocol:
    scale = None
    if order.px_per_mm is not None and order.origin_px is not None:
        scale = {
            "px_per_mm": order.px_per_mm,
            "origin_px": list(order.origin_px),
            "insertion": order.insertion,
        }
    values = {
        "schema_version": 1,
        "experiment": "import",
        "title": plain_text(folder.resolve().name),
        "seed": 0,
        "needle": {"needle_id": "unknown", "diameter_mm": order.needle_diameter_mm},
        "sheath_diameter_mm": order.sheath_diameter_mm,
        "scale": scale,
        "analysis": {
            "window_start_mm": 4.0,
            "window_end_mm": 2.0,
            "min_window_mm": 15.0,
            "max_radius_sigma_mm": 0.5,
            "max_radius_sigma_percent": 2.0,
            "roll_sd_deg": _ROLL_SD_DEG,
        },
    }
    return validate_values(values, "labrig import", ImportProtocol)


def _find_pictures(folder: Path) -> list[Path]:
    found = [path for path in folder.iterdir() if path.suffix.lower() in PICTURE_SUFFIXES and path.is_file()]
    return sorted(found, key=number_order)


def _make_run_name(folder: Path) -> str:
    """Return the folder's name without characters that are not allowed in a run's name."""
    return re.sub(r"[^\w.-]+", "-", folder.resolve().name).strip("-.") or "pictures"
