"""Collect the provenance of a run: code, packages and computer."""

import getpass
import os
import platform
import re
import shutil
import subprocess
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path, PurePosixPath

from labrig import __version__
from labrig.record.json_lines import plain_text
from labrig.record.processor import describe_processor
from labrig.record.source_digest import digest_sources

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
        `labrig` (version), `source_sha256` (of the installed code, by `digest_sources`), `git_commit` and `git_dirty`
        (of the package's source; None outside a checkout), `command_line`, `python`, `platform`, `processor` (by
        `describe_processor`), `host`, `account` (user name, None without one), `packages` {name: version} of labrig's
        direct dependencies.
    """
    program = [Path(word).name for word in command_line[:1]]
    return {
        "labrig": __version__,
        "source_sha256": digest_sources(),
        **_read_git_state(_SOURCE_TREE),
        "command_line": [plain_text(word) for word in (*program, *command_line[1:])],
        "python": platform.python_version(),
        "platform": platform.platform(),
        "processor": describe_processor(),
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

    Changed files, then new files of Python code that git does not ignore. Other new files, hidden ones and links, such
    as .env, may be private and are left out.
    """
    changed = _run_git(tree, "diff", "--binary", "--no-ext-diff", "--no-color", "HEAD", "--", "labrig")
    new = _run_git(tree, "ls-files", "-z", "--others", "--exclude-standard", "--", "labrig") or b""
    names = (os.fsdecode(name) for name in new.split(b"\0") if name)
    added = (_diff_new_file(tree, name) for name in names if _is_code(tree, PurePosixPath(name)))
    return b"".join([changed or b"", *added])


def _is_code(tree: Path, name: PurePosixPath) -> bool:
    hidden = any(part.startswith(".") for part in name.parts)
    path = tree / name
    return name.suffix == ".py" and not hidden and path.is_file() and not path.is_symlink()


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
