"""A folder for matplotlib's fonts and settings where the account has none: matplotlib would warn of that at each start.

Where it looks is in its documentation, "Environment variables": MPLCONFIGDIR, else the folders of XDG on Linux.
"""

import atexit
import os
import sys
from collections.abc import MutableMapping
from contextlib import suppress
from pathlib import Path

_VARIABLE = "MPLCONFIGDIR"


def provide_matplotlib_folder(environ: MutableMapping[str, str]) -> None:
    """Set MPLCONFIGDIR to a temporary folder, until this process ends, if matplotlib could write to none of its own."""
    if _VARIABLE in environ or not sys.platform.startswith("linux"):
        return
    home = Path(environ.get("HOME") or os.path.expanduser("~"))  # noqa: PTH111 - Path.home() may raise
    settings = Path(environ.get("XDG_CONFIG_HOME") or home / ".config")
    cache = Path(environ.get("XDG_CACHE_HOME") or home / ".cache")
    if all(_can_write(base / "matplotlib") for base in (settings, cache)):
        return
    import shutil
    import tempfile

    with suppress(OSError):  # without it matplotlib warns, and works
        environ[_VARIABLE] = tempfile.mkdtemp(prefix="labrig-matplotlib-")
        atexit.register(shutil.rmtree, environ[_VARIABLE], ignore_errors=True)


def _can_write(folder: Path) -> bool:
    """Return whether a folder can be written, or made where the nearest folder above is."""
    with suppress(OSError):
        nearest = next((path for path in (folder, *folder.parents) if os.path.lexists(path)), None)
        return nearest is not None and nearest.is_dir() and os.access(nearest, os.W_OK)
    return False
