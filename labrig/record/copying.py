"""Copy a record file by file, and read the copy back."""

import shutil
from pathlib import Path

from labrig.durable import disk_errors
from labrig.errors import DiskError
from labrig.record.digest import hash_file


def copy_record(run: Path, folder: Path) -> None:
    """Copy a run with results and notes into an existing folder; links and hidden files are left out.

    Raises
    ------
    RecordError
        When a file cannot be read.
    DiskError
        When a file cannot be written, or is not the same when it is read back.
    """
    for path in sorted(run.rglob("*")):
        relative = path.relative_to(run)
        if path.is_file() and not path.is_symlink() and not relative.name.startswith("."):
            sha256 = hash_file(path)
            with disk_errors(folder / relative):
                (folder / relative).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, folder / relative)
            if hash_file(folder / relative) != sha256:
                raise DiskError(
                    f"{folder / relative} is not what was copied from {path}: its SHA-256 differs",
                    "test the disk; the record itself is unchanged",
                )
