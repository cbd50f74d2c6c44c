"""The entry point: what a process that cannot even import its commands says."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from labrig.errors import BugError

_MODULES = ("typer", "labrig.posix", "labrig.errors", "labrig.cli.signals", "labrig.cli.main")
_CODE = "import sys; sys.modules['{}'] = None; from labrig.cli.start import main; main()"


def _start_without(module: str, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a command line in a process that cannot import this module, with `folder` for temporary files."""
    return subprocess.run(
        [sys.executable, "-c", _CODE.format(module), *arguments],
        capture_output=True,
        text=True,
        check=False,
        env=_environment(folder),
        timeout=60,
    )


def _environment(folder: Path) -> dict[str, str]:
    return {**os.environ, "TMPDIR": str(folder)}


@pytest.mark.parametrize("module", _MODULES)
def test_an_import_that_fails_at_the_start_is_reported_as_a_bug(module: str, tmp_path: Path) -> None:
    """It exits with 5, prints one sentence and a hint, and leaves its traceback in the named file."""
    done = _start_without(module, tmp_path, "--version")
    assert (done.returncode, done.stdout) == (BugError.exit_code, "")
    said = re.fullmatch(
        r"error: (labrig itself failed: .+)\nhint: please report it, with the traceback in (.+)\n",
        done.stderr,
    )
    assert said is not None, done.stderr
    assert module in said[1]
    (file,) = tmp_path.iterdir()
    assert said[2] == str(file)
    text = file.read_text(encoding="utf-8")
    assert "--version" in text.splitlines()[0]
    assert "Traceback (most recent call last)" in text
    assert module in text


def test_an_import_that_fails_is_a_document_with_json(tmp_path: Path) -> None:
    """Standard output then holds one JSON document with the error, as of every other bug."""
    done = _start_without("typer", tmp_path, "runs", "--json")
    error = json.loads(done.stdout)["error"]
    assert (done.returncode, error["type"]) == (BugError.exit_code, BugError.__name__)
    assert "typer" in error["message"]
    (file,) = tmp_path.iterdir()
    assert error["hint"].endswith(str(file))


@pytest.mark.parametrize("redirection", [">/dev/full", "2>/dev/full", ">&-", "2>&-"])
def test_a_failed_import_that_nobody_can_be_told_of_keeps_its_exit_code(
    redirection: str, tmp_path: Path
) -> None:
    """A stream that is full or closed changes neither the exit code nor the file."""
    command = f"'{sys.executable}' -c \"{_CODE.format('typer')}\" runs --json {redirection}"
    done = subprocess.run(["bash", "-c", command], env=_environment(tmp_path), check=False, timeout=60)
    assert done.returncode == BugError.exit_code
    assert len(list(tmp_path.iterdir())) == 1
