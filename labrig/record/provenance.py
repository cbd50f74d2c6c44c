"""Collect the provenance of a run: code, packages, computer, and the kernels that numbers were computed with.

numpy, OpenCV with IPP, BLAS and the C library hold several versions of their loops, and take at load time those that
the processor runs best. They round differently, so the last digits of a result rest on them.
"""

import getpass
import hashlib
import math
import os
import platform
import re
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from importlib import metadata
from pathlib import Path

import cv2
import numpy as np
from threadpoolctl import threadpool_info

from labrig import __version__
from labrig.record.json_lines import plain_text

_SOURCE_TREE = Path(__file__).parents[2]
_GIT_TIMEOUT_S = 10.0
_CODE = (".py", ".jinja", ".html", ".css", ".js", ".svg")
_NO_CODE = ("examples/", "manual/")
"""What a wheel holds beside the code; in a checkout the first stands elsewhere."""
# The names of features that kernels are chosen by begin so, on x86-64 and on 64-bit ARM.
_FEATURES = ("sse4", "avx", "fma", "asimd", "sve")
# The exact value ends so near the middle of two doubles that glibc rounds it up where it uses FMA, and down elsewhere.
_EXP_OF, _EXP_WITH_FMA = 0.5768, float.fromhex("0x1.c7c3da95bb8b9p+0")


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
    account = None
    with suppress(OSError, KeyError):  # an account without a name
        account = getpass.getuser()
    return {
        "labrig": __version__,
        "source_sha256": digest_sources(),
        **_read_git_state(_SOURCE_TREE),
        "command_line": [plain_text(word) for word in (*program, *command_line[1:])],
        "python": platform.python_version(),
        "platform": platform.platform(),
        "processor": describe_processor(),
        "host": platform.node(),
        "account": account,
        "packages": dict(_list_packages()),
    }


@cache
def _list_packages() -> tuple[tuple[str, str], ...]:
    """Return labrig's direct dependencies with their versions: those that this process began with."""
    requirements = metadata.requires("labrig") or ()
    names = (re.split(r"[^A-Za-z0-9._-]", text)[0] for text in requirements if "extra ==" not in text)
    return tuple((name, metadata.version(name)) for name in sorted(names))


@cache
def digest_sources(package: Path = Path(__file__).parents[1]) -> str:
    """Return the SHA-256 of the code and the templates of a package, so that a record without a commit says it too.

    It is that of what `sha256sum` prints for the files, which are named from the package's folder, in the order of
    their names by byte: the same for a checkout, a wheel and an installation of it.
    """
    listing = hashlib.sha256()
    for name in sorted(path.relative_to(package).as_posix() for path in package.rglob("*.*")):
        if name.endswith(_CODE) and not name.startswith(_NO_CODE) and "/." not in name:
            digest = hashlib.sha256((package / name).read_bytes()).hexdigest()
            listing.update(f"{digest}  {name}\n".encode())
    return listing.hexdigest()


def collect_code_diff(tree: Path = _SOURCE_TREE) -> bytes:
    """Return the changes of the package's source since its commit, as a patch for `git apply`; empty without any.

    Changed files, then new files of Python code that git does not ignore. Other new files, hidden ones and links, such
    as .env, may be private and are left out.
    """
    changed = _run_git(tree, "diff", "--binary", "--no-ext-diff", "--no-color", "HEAD", "--", "labrig") or b""
    new = _run_git(tree, "ls-files", "-z", "--others", "--exclude-standard", "--", "labrig/*.py") or b""
    names = [name for name in os.fsdecode(new).split("\0") if name and "/." not in name]
    compare = ("diff", "--binary", "--no-ext-diff", "--no-color", "--no-index", "--", os.devnull)
    added = [_run_git(tree, *compare, name) for name in names if not (tree / name).is_symlink()]
    return b"".join([changed, *(diff or b"" for diff in added)])


def _read_git_state(tree: Path) -> dict[str, object]:
    commit = _run_git(tree, "rev-parse", "HEAD")
    changes = _run_git(tree, "status", "--porcelain", "--", "labrig")
    return {
        "git_commit": commit.decode().strip() if commit else None,
        "git_dirty": None if changes is None else bool(changes),
    }


def _run_git(tree: Path, *arguments: str) -> bytes | None:
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
    return done.stdout if done.returncode in {0, 1} else None  # 1: the files differ


def describe_processor() -> dict[str, str]:
    """Return the processor and the kernels in use in this process, as JSON.

    Returns
    -------
    dict
        `model` (name of the processor), `features` (those of it that kernels are chosen by, as the operating system
        calls them), `numpy` and `opencv` (the features for which they use kernels of their own), `ipp` (its kernels and
        version, or `off`), `libm` (the C library, and whether it computes with FMA), and `blas_LIBRARY` for each BLAS
        that is loaded, such as `blas_numpy: OpenBLAS SkylakeX`.
    """
    cpu: dict[str, str] = {}
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
        key, _, value = line.partition(":")
        cpu.setdefault(key.strip(), value.strip())  # of the first processor
    flags = cpu.get("flags", cpu.get("Features", "")).split()
    # A feature has a star if kernels are chosen by it, and a question mark if they are not chosen here.
    opencv = [name.removeprefix("*") for name in cv2.getCPUFeaturesLine().split() if not name.endswith("?")]
    ipp = cv2.ipp.getIppVersion().removeprefix("ippIP ").partition(" (-)")[0]
    fma = "with" if math.exp(_EXP_OF) == _EXP_WITH_FMA else "without"
    return {
        "model": cpu.get("model name", platform.machine()),
        "features": " ".join(flag for flag in flags if flag.startswith(_FEATURES)),
        "numpy": " ".join(np.show_config(mode="dicts").get("SIMD Extensions", {}).get("found", ())),
        "opencv": " ".join(opencv),
        "ipp": ipp if cv2.ipp.useIPP() else "off",
        "libm": f"{os.confstr('CS_GNU_LIBC_VERSION')} {fma} FMA",
        **_name_blas(),
    }


def _name_blas() -> dict[str, str]:
    """Return the kernels of each BLAS that is loaded, by the package whose wheel it came with, or by its folder."""
    return {
        f"blas_{Path(found['filepath']).parent.name.removesuffix('.libs')}": (
            f"{found['internal_api']} {found.get('architecture', found.get('version'))}"
        )
        for found in sorted(threadpool_info(), key=lambda found: str(found["filepath"]))
        if found["user_api"] == "blas"
    }


def describe_change(recorded: object, now: object) -> str:
    """Return in one sentence how two descriptions differ; empty if they do not.

    Parameters
    ----------
    recorded, now : object
        As from `describe_processor`. What one of them does not hold is not compared; nor are `features`, since kernels
        tell which of them were used.

    Returns
    -------
    str
        Such as "made with blas openblas SkylakeX, and this is blas openblas Haswell".
    """
    if not isinstance(recorded, Mapping) or not isinstance(now, Mapping):
        return ""
    shared = [key for key in recorded if key in now and key != "features"]
    changed = [key for key in shared if recorded[key] != now[key]]
    was, here = (
        " and ".join(dict.fromkeys(f"{key.partition('_')[0]} {side[key]}" for key in changed))
        for side in (recorded, now)
    )
    return f"made with {was}, and this is {here}" if changed else ""
