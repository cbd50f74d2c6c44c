"""Close a run: check what was written, and write the manifest that says how the run ended."""

import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path

from labrig.errors import BugError, Problem, RecordError
from labrig.record.chain import scan_chain
from labrig.record.check import check_closing
from labrig.record.layout import COPY_HINT, MANIFEST
from labrig.record.manifest import DAMAGED_WHEN_CLOSED, read_manifest
from labrig.record.opening import encode_manifest
from labrig.record.seal import find_changes_since_sealing
from labrig.record.sealing import seal_closing

_HINT = (
    "the run is kept and marked as damaged; test the disk and the memory of this computer, and if both are sound "
    "report this with what labrig runs check says of the run"
)


def write_closing_manifest(
    run: Path, manifest: Mapping[str, object], sums: Mapping[str, str], ended: datetime
) -> None:
    """Check all other files of a run, then seal it and write its manifest, which marks a damaged run as failed.

    Parameters
    ----------
    sums : Mapping
        The content of SHA256SUMS.

    Raises
    ------
    BugError
        When the run is damaged although only labrig has written it; names the first damaged place.
    DiskError
        When the manifest cannot be written.
    """
    content = encode_manifest(manifest)
    damage = check_closing(run, json.loads(content))
    if not damage:
        seal_closing(run, content, sums, ended)
        damage = _check_written(run, json.loads(content))
    if damage:
        message = _describe_damage(run, damage)
        seal_closing(run, encode_manifest(_mark(manifest, damage, message)), sums, ended)
        raise BugError(message, _HINT)


def _check_written(run: Path, manifest: Mapping[str, object]) -> tuple[Problem, ...]:
    """Read manifest, chain and sums back and compare them with what was written."""
    try:
        if read_manifest(run) != manifest:
            return (Problem(MANIFEST, "what is read back is not what was written", COPY_HINT),)
        return tuple(find_changes_since_sealing(run, manifest, scan_chain(run)))
    except RecordError as error:
        return (Problem(MANIFEST, error.message, error.hint),)


def _describe_damage(run: Path, damage: Sequence[Problem]) -> str:
    first, more = damage[0], len(damage) - 1
    others = f", and {more} more" if more else ""
    return f"{run.name} is damaged as labrig itself wrote it: {first.where}: {first.message}{others}"


def _mark(manifest: Mapping[str, object], damage: Sequence[Problem], message: str) -> dict[str, object]:
    """Return the manifest of a run that failed because it is damaged; how it ended otherwise stays beside that."""
    ended = f"it had ended as {manifest['exit_status']}"
    told = f"{ended}: {manifest['reason']}" if manifest["reason"] else ended
    return {
        **manifest,
        "exit_status": "failed",
        "reason": f"{message}; {told}",
        DAMAGED_WHEN_CLOSED: [f"{problem.where}: {problem.message}" for problem in damage],
    }
