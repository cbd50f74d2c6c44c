"""What commands that write calibration files share: their options, checks, provenance and report."""

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from typer import Option

from labrig.cli.output import print_json, print_line, say, say_failure
from labrig.errors import CalibrationRefusedError, InputError, OutputExistsError

OutOption = Annotated[Path | None, Option(metavar="FILE", help="Calibration file to write.")]
ForceOption = Annotated[
    bool,
    Option("--force", help="Replace existing files; also write a refused calibration, marked as refused."),
]


def require_writable(
    out: Path | None, force: bool, hint: str = "choose another name, or replace it with --force"
) -> None:
    """Refuse a file that exists or cannot be written, before any work is done."""
    if out is None:
        return
    if out.is_dir():
        raise InputError(f"{out} is a folder", "name a file in it")
    if not out.parent.is_dir():
        raise InputError(f"there is no folder {out.parent} for {out.name}", "make the folder first")
    if out.exists() and not force:
        raise OutputExistsError(f"{out} exists", hint)


def collect_calibration_provenance(images: Sequence[Path]) -> dict[str, object]:
    """Return how a calibration file was made: code, command, time, hashes of the pictures, their camera if known."""
    import hashlib

    from labrig.devices.clocks import SystemClock
    from labrig.input_file import read_file
    from labrig.record.json_lines import plain_text
    from labrig.record.provenance import collect_provenance
    from labrig.vision.calibration_file import CAMERA, read_common_camera
    from labrig.vision.picture import MAX_PICTURE_BYTES

    camera = read_common_camera(images)
    return {
        **collect_provenance(sys.argv),
        "created": SystemClock().utc().isoformat(timespec="seconds"),
        "pictures": {
            plain_text(path.name): hashlib.sha256(read_file(path, MAX_PICTURE_BYTES)).hexdigest()
            for path in images
            if path.is_file()
        },
        **({} if camera is None else {CAMERA: camera.model_dump()}),
    }


def report_calibration(
    document: Mapping[str, Any],
    print_numbers: Callable[[Mapping[str, Any]], None],
    out: Path | None,
    force: bool,
) -> int:
    """Print a calibration, and whether it was written; return the exit code."""
    accepted = document["accepted"]
    print_json(document)
    print_line("accepted" if accepted else "refused")
    for reason in document["reasons"]:
        print_line(f"  {reason}")
    print_numbers(document)
    if out is not None:
        remark = "" if accepted else " (a refused calibration, marked as refused)"
        say(f"written: {out}{remark}" if accepted or force else f"not written: {out}")
    return 0 if accepted else 1


def report_refusal(refusal: CalibrationRefusedError, nothing: Mapping[str, object]) -> int:
    """Report a calibration without any numbers; unknown values are null."""
    print_json({"accepted": False, "reasons": [refusal.message], **nothing})
    say_failure(refusal)
    return refusal.exit_code
