"""The entry point: what a process that cannot even import its commands says."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from labrig.errors import BugError

_CODE = "import sys; sys.modules['{}'] = None; from labrig.cli.start import main; main()"


def _start_without(module: str, folder: Path, words: str) -> subprocess.CompletedProcess[str]:
    """Run a command line in a process that cannot import this module, with `folder` for temporary files."""
    command = f"'{sys.executable}' -c \"{_CODE.format(module)}\" {words}"
    environment = {**os.environ, "TMPDIR": str(folder)}
    return subprocess.run(
        ["bash", "-c", command], capture_output=True, text=True, check=False, env=environment, timeout=60
    )


@pytest.mark.parametrize(
    "module", ["typer", "labrig.posix", "labrig.errors", "labrig.cli.signals", "labrig.cli.main"]
)
def test_an_import_that_fails_at_the_start_is_reported_as_a_bug(module: str, tmp_path: Path) -> None:
    """It exits with 5, prints one sentence and a hint, and leaves its traceback in the named file."""
    done = _start_without(module, tmp_path, "--version")
    assert (done.returncode, done.stdout) == (BugError.exit_code, "")
    said = re.fullmatch(
        r"error: (labrig itself failed: .+)\nhint: please report it, with the traceback in (.+)\n",
        done.stderr,
    )
    assert said is not None, done.stderr
    (file,) = tmp_path.iterdir()
    text = file.read_text(encoding="utf-8")
    assert (said[2], module in said[1], module in text, "--version" in text.splitlines()[0]) == (
        str(file), True, True, True,
    )  # fmt: skip
    assert "Traceback (most recent call last)" in text


@pytest.mark.parametrize("redirection", ["", ">/dev/full", "2>/dev/full", ">&-", "2>&-"])
def test_a_failed_import_keeps_its_exit_code_where_nobody_can_be_told(
    redirection: str, tmp_path: Path
) -> None:
    """A stream that is full or closed changes neither code nor file; with --json the error is a document."""
    done = _start_without("typer", tmp_path, f"runs --json {redirection}")
    (file,) = tmp_path.iterdir()
    assert done.returncode == BugError.exit_code
    if not redirection:
        error = json.loads(done.stdout)["error"]
        told = (error["type"], "typer" in error["message"], error["hint"].endswith(str(file)))
        assert told == (BugError.__name__, True, True)
