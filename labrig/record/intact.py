"""Remember which pictures this process has read and found intact, by the identity of their files.

A command reads a picture for several reasons; it is hashed once, as long as its file is the same. A process that is
forked knows what its parent has found. `labrig runs check` asks for none of this: it reads everything.
"""

from pathlib import Path
from typing import TypeAlias

Identity: TypeAlias = tuple[int, int, int, int, int, str]
"""Device, inode, size [bytes] and time of change [ns] of a file, the place in it, and the SHA-256 to be found there."""

_MOST = 100_000
_INTACT: set[Identity] = set()


def identify(path: Path, offset: int, sha256: str) -> Identity | None:
    """Return the identity of what a file holds now, to be asked for before it is read; None if it cannot be seen."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, offset, sha256


def is_intact(identity: Identity | None) -> bool:
    """Return whether this process has read that and found it intact."""
    return identity in _INTACT


def remember_intact(identity: Identity | None) -> None:
    """Remember that what was read is intact."""
    if identity is None:
        return
    if len(_INTACT) >= _MOST:
        _INTACT.clear()
    _INTACT.add(identity)
