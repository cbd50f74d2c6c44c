"""Collect the provenance of a run: code, packages and computer."""

import getpass
import os
import platform
import re
import shutil
import subprocess
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

from labrig import __version__

_SOURCE_TREE = Path(__file__).parents[2]
_GIT_TIMEOUT_S = 10.0


def collect_provenance(command_line: Sequence[str]) -> dict[str, object]:
    """Return what is needed to run the same code again, without time of day or folders of this computer.

    Parameters
    ----------
    command_line : sequence of str
        As in `sys.argv`; only the name of the program is kept.

    Returns
    -------
    dict
        `labrig` (version), `git_commit` and `git_dirty` (of the package's source; None outside a checkout),
        `command_line`, `python`, `platform`, `host`, `account` (user name, None without one), `packages` {name:
        version} of labrig's direct dependencies.
    """
    program = [Path(word).name for word in command_line[:1]]
    return {
        "labrig": __version__,
        **_read_git_state(_SOURCE_TREE),
        "command_line": [*program, *command_line[1:]],
        "python": platform.python_version(),
        "platform": platform.platform(),
        "host": platform.node(),
        "account": _read_account(),
        "packages": _read_package_versions(),
    }


def _read_account() -> str | None:
    try:
        return getpass.getuser()
    except (OSError, KeyError):
        return None


def collect_code_diff(tree: Path = _SOURCE_TREE) -> bytes:
    """Return the changes of the package's source since its commit, as a patch for `git apply`; empty without any.

    Parameters
    ----------
    tree : Path
        The checkout.

    Returns
    -------
    bytes
        Changed files, then new files that git does not ignore.
    """
    changed = _run_git(tree, "diff", "--binary", "--no-ext-diff", "--no-color", "HEAD", "--", "labrig")
    unknown = _run_git(tree, "ls-files", "-z", "--others", "--exclude-standard", "--", "labrig") or b""
    added = [_diff_new_file(tree, os.fsdecode(name)) for name in unknown.split(b"\0") if name]
    return b"".join([changed or b"", *added])


def _diff_new_file(tree: Path, name: str) -> bytes:
    # git exits with 1 if the files differ.
    arguments = ("diff", "--binary", "--no-ext-diff", "--no-color", "--no-index", "--", os.devnull, name)
    return _run_git(tree, *arguments, succeeds=(0, 1)) or b""


def _read_git_state(tree: Path) -> dict[str, object]:
    commit = _run_git(tree, "rev-parse", "HEAD")
    changes = _run_git(tree, "status", "--porcelain", "--", "labrig")
    return {
        "git_commit": commit.decode().strip() if commit else None,
        "git_dirty": None if changes is None else bool(changes),
    }


def _run_git(tree: Path, *arguments: str, succeeds: tuple[int, ...] = (0,)) -> bytes | None:
    """Return the output of git; None without git, without a checkout, or when git refuses."""
    program = shutil.which("git")
    if program is None or not (tree / ".git").exists():
        return None
    # A git hook that starts labrig would point it at another repository.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    try:
        done = subprocess.run(  # noqa: S603 - the program that PATH names, with fixed words
            [program, "--no-optional-locks", "-C", str(tree), *arguments],
            capture_output=True, check=False, env=environment, timeout=_GIT_TIMEOUT_S, cwd=tree,
        )  # fmt: skip
    except (subprocess.SubprocessError, OSError):
        return None
    return done.stdout if done.returncode in succeeds else None


def _read_package_versions() -> dict[str, str]:
    requirements = metadata.requires("labrig") or ()
    names = (_parse_distribution_name(text) for text in requirements if "extra ==" not in text)
    return {name: metadata.version(name) for name in sorted(names)}


def _parse_distribution_name(requirement: str) -> str:
    return re.split(r"[^A-Za-z0-9._-]", requirement, maxsplit=1)[0]
