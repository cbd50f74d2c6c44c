"""The folder that an export or a comparison is written to, and copies of records.

What is written is made in a temporary folder beside it and moved into place when it is complete.
"""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from labrig.durable import disk_errors, sync_directory
from labrig.errors import InputError, OutputExistsError
from labrig.record.layout import MANIFEST, PROTOCOL, read_manifest


def require_apart(out: Path, run: Path, *, record: bool) -> None:
    """Refuse to export a run into itself (`InputError`), or over a run (`OutputExistsError`).

    Only a copy of the same run is replaced, by its `record`.
    """
    target = out.resolve()
    if target.is_relative_to(run.resolve()):
        raise InputError(f"{out} lies in {run}, the run that is exported", "name a folder outside of it")
    if all((target / name).exists() for name in (MANIFEST, PROTOCOL)):
        ours, theirs = read_manifest(run), read_manifest(target)
        if not record or any(
            ours.get(key) != theirs.get(key) for key in ("run", "started", "seed", "protocol")
        ):
            raise OutputExistsError(f"{out} is a run, and is not written over", "name another folder")


@contextmanager
def output_folder(out: Path, *, force: bool | None = None) -> Iterator[Path]:
    """Give a folder to write into; its files go to `out` when the block ends without an error.

    Parameters
    ----------
    force : bool | None
        Replace files of the same names if `out` exists; other files in it stay. None: of a command without --force.

    Raises
    ------
    OutputExistsError
        When it exists and `force` is not set; nothing has been written.
    DiskError
        When it cannot be written.
    """
    if out.exists() and not out.is_dir():
        raise OutputExistsError(f"{out} is a file", "name a folder")
    if out.exists() and not force:
        replace = "" if force is None else ", or replace its files with --force"
        raise OutputExistsError(f"{out} exists already", f"name another with --out{replace}")
    with disk_errors(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=out.parent))
    try:
        yield folder
        with disk_errors(out):
            _move_files(folder, out)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def copy_record(run: Path, folder: Path) -> None:
    """Copy a run with results and notes into a folder; links and hidden files are left out. Raises `DiskError`."""

    def leave_out(parent: str, names: list[str]) -> list[str]:
        return [name for name in names if name.startswith(".") or Path(parent, name).is_symlink()]

    with disk_errors(folder):
        shutil.copytree(run, folder, ignore=leave_out, dirs_exist_ok=True)


def _move_files(folder: Path, target: Path) -> None:
    """Rename each file into place; a link there, to a file or a folder, is replaced, not followed."""
    for path in sorted(folder.rglob("*")):
        place = target / path.relative_to(folder)
        if path.is_dir() and place.is_symlink():
            place.unlink()
        if path.is_file():
            place.parent.mkdir(parents=True, exist_ok=True)
            path.replace(place)
    sync_directory(target)
