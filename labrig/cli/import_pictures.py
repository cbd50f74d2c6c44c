"""`labrig import`: turns folders of pictures into runs."""

import hashlib
import re
import shlex
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from typer import Argument

from labrig.cli.options import (
    DEFAULT_NEEDLE_DIAMETER_MM,
    IntrinsicsOption,
    NeedleDiameterOption,
    OptionalInsertion,
    OriginOption,
    PlaneOption,
    PxPerMmOption,
    RunsDirOption,
    SheathDiameterOption,
    find_runs_dir,
)
from labrig.cli.output import print_json, print_line, say
from labrig.errors import InputError, PictureError


def import_(
    folder: Annotated[
        Path, Argument(metavar="FOLDER", help="Folder of pictures, or of folders of pictures.")
    ],
    px_per_mm: PxPerMmOption = None,
    origin_px: OriginOption = None,
    insertion: OptionalInsertion = None,
    intrinsics: IntrinsicsOption = None,
    plane: PlaneOption = None,
    needle_diameter_mm: NeedleDiameterOption = DEFAULT_NEEDLE_DIAMETER_MM,
    sheath_diameter_mm: SheathDiameterOption = None,
    runs_dir: RunsDirOption = None,
) -> int:
    """Copy the pictures into runs, one for each folder; reanalyze, report and view take them like any other run."""
    from labrig.cli.mapping import load_plane_map
    from labrig.experiments.imported_pictures.protocol import ImportProtocol
    from labrig.protocol.yaml_file import validate_values
    from labrig.record.json_lines import plain_text
    from labrig.vision.curvature import CurvatureSettings

    found = _find_pictures(folder)
    load_plane_map(intrinsics, plane, px_per_mm, origin_px, insertion)
    place, rows = find_runs_dir(runs_dir), []
    given = {"intrinsics.json": intrinsics, "plane.json": plane}
    settings = CurvatureSettings(sheath_diameter_mm=None, max_radius_sigma_percent=2.0)
    calibration = {name: path for name, path in given.items() if path is not None}
    for source, pictures in found.items():
        values = {
            "schema_version": 1,
            "experiment": "import",
            "title": plain_text(source.resolve().name),
            "seed": 0,
            "needle": {"needle_id": "unknown", "diameter_mm": needle_diameter_mm},
            "sheath_diameter_mm": sheath_diameter_mm,
            "scale": px_per_mm and {"px_per_mm": px_per_mm, "origin_px": origin_px, "insertion": insertion},
            "analysis": settings.model_dump(exclude={"needle_diameter_mm"}, exclude_none=True),
        }
        protocol = validate_values(values, "labrig import", ImportProtocol)
        rows.append({"folder": str(source), **_import(source, pictures, protocol, calibration, place)})
        print_line(f"{rows[-1]['run']}" + (f"  ({rows[-1]['reason']})" if rows[-1]["reason"] else ""))
    print_json(rows)
    named = shlex.quote(str(rows[0]["run"])) + (" ..." if rows[1:] else "")
    say(f"measure the pictures: labrig reanalyze {named}\nthen write the page: labrig report {named}")
    return 0 if all(row["ok"] for row in rows) else 1


def _find_pictures(folder: Path) -> dict[Path, list[Path]]:
    """Return the pictures, by the numbers in their names, of the folder and of each folder in it that has any.

    Raises
    ------
    InputError
        When there is no such folder, or no picture in it.
    """
    from labrig.vision.picture import PICTURE_SUFFIXES, number_order

    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder", "name a folder of pictures")
    found = {}
    for place in (folder, *sorted(path for path in folder.iterdir() if path.is_dir())):
        files = (one for one in place.iterdir() if one.suffix.lower() in PICTURE_SUFFIXES and one.is_file())
        if pictures := sorted(files, key=number_order):
            found[place] = pictures
    if not found:
        endings = " ".join(sorted(PICTURE_SUFFIXES))
        raise InputError(f"no picture in {folder} or in a folder of it", f"pictures end in {endings}")
    return found


def _import(
    folder: Path,
    pictures: Sequence[Path],
    protocol: Any,
    calibration: Mapping[str, Path],
    runs_dir: Path,
) -> dict[str, object]:
    """Copy pictures into a new run; one that cannot be read is named in the run's events and left out.

    Raises
    ------
    InputError
        When none can be read.
    """
    from labrig.devices.clocks import SystemClock
    from labrig.protocol.yaml_file import dump_yaml
    from labrig.record.layout import read_checksum
    from labrig.record.provenance import collect_provenance
    from labrig.record.writer import Recorder, create_under_free_name, opening_files

    _require_readable(folder, pictures)
    started = SystemClock().utc()
    create = partial(
        Recorder.create,
        runs_dir,
        manifest={
            "experiment": protocol.experiment,
            "title": protocol.title,
            "operator": protocol.operator,
            "seed": protocol.seed,
            "started": started.isoformat(timespec="seconds"),
            "trials_planned": 0,
            "provenance": collect_provenance(sys.argv),
            "protocol": protocol.model_dump(mode="json"),
        },
        files=opening_files(dump_yaml(protocol), calibration=calibration),
    )
    # Without characters that are not allowed in a run's name.
    name = re.sub(r"[^\w.-]+", "-", folder.resolve().name).strip("-.") or "pictures"
    recorder = create_under_free_name(started, name, create)
    refused = sum(not _copy(path, number, recorder) for number, path in enumerate(pictures))
    reason = f"{refused} of {len(pictures)} pictures could not be read" if refused else ""
    recorder.close("success", reason, SystemClock().utc())
    checksum = read_checksum(recorder.path)
    return {"run": str(recorder.path), "ok": not refused, "reason": reason or None, "checksum": checksum}


def _require_readable(folder: Path, pictures: Sequence[Path]) -> None:
    from labrig.vision.picture import read_picture

    refusals = []
    for path in pictures:
        try:
            read_picture(path)
        except PictureError as error:
            refusals.append(error)
        else:
            return
    raise InputError(f"no picture in {folder} can be read: {refusals[0].message}", refusals[0].hint)


def _copy(path: Path, number: int, recorder: Any) -> bool:
    """Record a picture, or an event that it cannot be read; return whether it can."""
    from labrig.experiments.imported_pictures.events import PictureRefused
    from labrig.experiments.shared.needle_events import NeedleRole
    from labrig.input_file import read_file
    from labrig.record.json_lines import plain_text
    from labrig.vision.picture import MAX_PICTURE_BYTES, read_picture

    name = plain_text(path.name)
    try:
        image = read_picture(path)
    except PictureError as error:
        say(f"left out: {error.message}")
        recorder.record_event(PictureRefused(source=name, reason=plain_text(error.message)), float(number))
        return False
    sha256 = hashlib.sha256(read_file(path, MAX_PICTURE_BYTES)).hexdigest()
    role = NeedleRole.IMPORTED
    recorder.frame(image, float(number), trial=None, role=role, source=name, source_sha256=sha256)
    return True
