"""What commands that write calibration files share: their options, checks and provenance."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from labrig.cli.output import failure_lines, print_json, say
from labrig.errors import CalibrationRefusedError, InputError, OutputExistsError

OutOption = Annotated[Path | None, typer.Option("--out", metavar="FILE", help="Calibration file to write.")]
ForceOption = Annotated[
    bool,
    typer.Option(
        "--force", help="Replace an existing file; also write a refused calibration, marked as refused."
    ),
]


_ANOTHER_NAME = "choose another name, or replace it with --force"


def require_writable(out: Path | None, force: bool, hint: str = _ANOTHER_NAME) -> None:
    """Refuse a file that exists or cannot be written, before any work is done."""
    if out is None:
        return
    if out.is_dir():
        raise InputError(f"{out} is a folder", "name a file in it")
    if not out.parent.is_dir():
        raise InputError(f"there is no folder {out.parent} for {out.name}", "make the folder first")
    if out.exists() and not force:
        raise OutputExistsError(f"{out} exists", hint)


def collect_calibration_provenance(images: list[Path]) -> dict[str, object]:
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


def report_output(out: Path | None, accepted: bool, force: bool) -> None:
    """Say whether a calibration was written."""
    if out is not None and (accepted or force):
        say(f"written: {out}" + ("" if accepted else " (a refused calibration, marked as refused)"))
    elif out is not None:
        say(f"not written: {out}")


def report_refusal(refusal: CalibrationRefusedError, nothing: dict[str, object], as_json: bool) -> int:
    """Report a calibration without any numbers; unknown values are null."""
    if as_json:
        print_json({"accepted": False, "reasons": [refusal.message], **nothing})
    for line in failure_lines(refusal):
        say(line)
    return refusal.exit_code
