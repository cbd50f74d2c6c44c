"""Fills the disk of a folder of two runs, `closed` and `open`, then has commands work there; argument: the folder.

Prints a JSON list of what each command said: its words, exit code and error.
"""

import contextlib
import io
import json
import os
import sys
from pathlib import Path

from labrig.cli.main import run_command


def fill(disk: Path) -> None:
    """Take every byte that is left."""
    descriptor = os.open(disk / "filling", os.O_WRONLY | os.O_CREAT)
    with contextlib.suppress(OSError):
        while True:
            os.write(descriptor, bytes(4096))
    os.close(descriptor)


def contents(runs: Path) -> dict[str, bytes]:
    """Return what every file of the runs holds."""
    return {
        str(path): path.read_bytes()
        for path in runs.rglob("*")
        if path.is_file() and path.stat().st_size and not path.name.startswith(".")
    }


def call_command(words: list[str]) -> dict[str, object]:
    """Carry out a command in this process, and return what it said."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        exit_code = run_command(words)
    return {"words": words, "exit_code": exit_code, "err": err.getvalue()}


def main(runs: Path) -> None:
    """Fill the disk, and try."""
    closed, interrupted = str(runs / "closed"), str(runs / "open")
    fill(runs)
    before = contents(runs)
    answers = [
        call_command(words)
        for words in (
            ["runs", "--runs-dir", str(runs), "--where", "exit_status=success"],
            ["runs", "annotate", interrupted, "--tag", "pilot"],
            ["runs", "annotate", closed, "--note", "cloudy"],
            ["reanalyze", closed],
            ["report", closed],
            ["export", closed, "--format", "csv", "--out", str(runs / "tables")],
        )
    ]
    print(json.dumps({"answers": answers, "unchanged": before.items() <= contents(runs).items()}))  # noqa: T201 - the test reads it


if __name__ == "__main__":
    main(Path(sys.argv[1]))
