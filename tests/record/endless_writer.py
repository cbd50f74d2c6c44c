"""Records until it is killed or the disk refuses; prints a line for each call that has returned."""

import argparse
import resource
import shutil
from itertools import count
from pathlib import Path

from labrig.errors import DiskError
from labrig.record.writer import Recorder
from tests.record.runs import ENDED, begin, picture


def acknowledge(name: str, number: int) -> None:
    """Tell the parent that a call has returned."""
    print(name, number, flush=True)  # noqa: T201 - the parent reads it


def record_forever(recorder: Recorder) -> None:
    """Append to every stream in turn."""
    for number in count():
        recorder.state(0.1 * number, number=number)
        acknowledge("states", number)
        recorder.event("step", 0.1 * number, number=number)
        acknowledge("events", number)
        recorder.frame(picture(number, (48, 64)), 0.1 * number, number=number)
        acknowledge("frames", number)


def limit_file_size(size: int) -> None:
    """Let the kernel refuse files beyond this size."""
    _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))


def main() -> None:
    """Record; a disk that refuses ends the run as a rig would end it."""
    parser = argparse.ArgumentParser()
    parser.add_argument("runs_dir", type=Path)
    parser.add_argument("--file-size", type=int, help="largest file that may be written")
    parser.add_argument("--copy-to", type=Path, help="where to copy the run when it has ended")
    arguments = parser.parse_args()
    recorder = begin(arguments.runs_dir)
    if arguments.file_size:
        limit_file_size(arguments.file_size)
    try:
        record_forever(recorder)
    except DiskError as error:
        limit_file_size(resource.RLIM_INFINITY)
        recorder.event("run_stop", 1e6, exit_status="failed")
        recorder.close("failed", error.message, ENDED)
    if arguments.copy_to:
        shutil.copytree(recorder.path, arguments.copy_to)


main()
