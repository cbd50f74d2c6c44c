"""What the rig must not forget between runs: whether a needle is in tissue, and which axes are referenced.

The file is replaced atomically and forced to disk. In doubt (no file, a damaged one) a needle may be in
tissue.
"""

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from labrig.record import write_atomically

_KIND = "labrig-rig-state"
_VERSION = 1


@dataclass(frozen=True)
class RigState:
    """What is known of the rig.

    Parameters
    ----------
    needle_in_tissue : bool or None
        None where nobody knows.
    since_run : str or None
        The run that put the needle there.
    referenced : tuple of str
        Axes whose zero has been set and has not been lost since.
    note : str
        Why something is not known.
    """

    needle_in_tissue: bool | None
    since_run: str | None = None
    referenced: tuple[str, ...] = ()
    note: str = ""

    @property
    def doubt(self) -> str:
        """Why a needle may be in tissue; empty when it is known that none is."""
        if self.needle_in_tissue:
            return f"run {self.since_run} ended with the needle in tissue"
        return "" if self.needle_in_tissue is False else self.note


NEW = RigState(needle_in_tissue=False)
"""State of a simulated rig, whose drives and world are new."""


class StateStore:
    """Keeps the state in a file, or, without a path, in memory.

    Parameters
    ----------
    path : Path or None
        The file; None for a rig that is new in every run.
    state : RigState
        What is known without a file.
    """

    def __init__(self, path: Path | None, state: RigState = NEW) -> None:
        self._path = path
        self.state = state if path is None else _load(path)

    def update(self, **changes: object) -> None:
        """Change the state and put it on disk before returning.

        Raises
        ------
        DiskError
        """
        self.state = replace(self.state, **changes)  # type: ignore[arg-type]
        if self._path is not None:
            _save(self._path, self.state)


def rig_state(path: Path | None) -> RigState:
    """Return what a rig knows of itself by its state file; that of a new rig without one."""
    return StateStore(path).state


def _load(path: Path) -> RigState:
    if not path.exists():
        return RigState(None, note="this rig has no state file yet")
    try:
        return _parse(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, KeyError, TypeError) as error:
        return RigState(None, note=f"the rig's state file {path.name} cannot be read ({error})")


def _parse(document: dict[str, object]) -> RigState:
    if (document["kind"], document["schema_version"]) != (_KIND, _VERSION):
        raise ValueError(f"kind {document['kind']}, version {document['schema_version']}")
    needle, since, referenced = document["needle_in_tissue"], document["since_run"], document["referenced"]
    if not (needle is None or isinstance(needle, bool)) or not (since is None or isinstance(since, str)):
        raise ValueError("needle_in_tissue is neither true, false nor null")
    if not isinstance(referenced, list):
        raise TypeError("referenced is no list")
    return RigState(needle, since, tuple(map(str, referenced)), str(document["note"]))


def _save(path: Path, state: RigState) -> None:
    document = {"kind": _KIND, "schema_version": _VERSION, **asdict(state)}
    write_atomically(path, (json.dumps(document, indent=2) + "\n").encode())
