"""What `labrig calibrate plane` does with a plane map: compares its scale with the last one, writes and prints it."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from labrig.cli.calibration_files import collect_calibration_provenance, report_output
from labrig.cli.last_plane import CONFIRMATION, compare_with_file, explain_no_comparison
from labrig.cli.output import print_json, print_line
from labrig.text import number
from labrig.vision.calibration_file import save_plane
from labrig.vision.plane import PlaneMap
from labrig.vision.scale_check import ScaleComparison, refuse_other_scale


@dataclass(frozen=True, eq=False)
class ComparedPlane:
    """A plane map, its comparison with the last one, None if there is none, and that in words."""

    plane: PlaneMap
    comparison: ScaleComparison | None
    sentence: str


def compare_scale(
    found: PlaneMap, last: Path | None, rig: Path | None, *, camera_moved: bool
) -> ComparedPlane:
    """Return a map, refused if its scale needs a person's confirmation, with the comparison."""
    comparison = compare_with_file(found, last, camera_moved=camera_moved)
    if comparison is None:
        return ComparedPlane(found, None, explain_no_comparison(rig, camera_moved=camera_moved))
    return ComparedPlane(refuse_other_scale(found, comparison, CONFIRMATION), comparison, comparison.sentence)


def finish_plane(
    compared: ComparedPlane, pictures: Sequence[Path], out: Path | None, *, force: bool, as_json: bool
) -> int:
    """Write and print a map, and return the exit code. What needs confirmation replaces no file, not even by force.

    Raises
    ------
    DiskError
        If the file cannot be written.
    """
    found, comparison = compared.plane, compared.comparison
    force = force and not (comparison is not None and comparison.needs_confirmation)
    if out is not None and (found.accepted or force):
        save_plane(out, found, collect_calibration_provenance(list(pictures)))
    document = {**found.to_json(), "scale_comparison": None if comparison is None else asdict(comparison)}
    if as_json:
        print_json(document)
    else:
        _print_plane(document, compared.sentence)
    report_output(out, found.accepted, force)
    return 0 if found.accepted else 1


def _print_plane(document: dict[str, Any], compared: str) -> None:
    print_line("accepted" if document["accepted"] else "refused")
    for reason in document["reasons"]:
        print_line(f"  {reason}")
    print_line(
        f"scale {document['mm_per_px']:.5f} mm/px, residual {document['rms_mm']:.4f} mm rms, "
        f"held out {number(document['holdout_rms_mm'], 4)} mm rms, flat within {document['flatness_mm']:.3f} mm"
    )
    if document["view"] is not None:
        print_line(document["view"])
    print_line(compared)
    for evidence in ("bend", "gel_measurement"):
        if document[evidence] is not None:
            print_line(document[evidence]["sentence"])
    for sentence in document["assumptions"]:
        print_line(f"assumed: {sentence}")
    if document["not_in_interval"]:
        print_line(f"not in the interval: {', '.join(document['not_in_interval'])}")
