"""Runs and exports outside the local disk: URLs that fsspec knows, such as those of an object store.

A live run, its results, pages and notes are written on the local disk only. A run behind a URL is copied to a temporary
folder and opened there, verified by its checksums like any other. An export is made in a temporary folder and moved
into place when it is complete.
"""

import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

import fsspec

from labrig.durable import disk_errors
from labrig.errors import DiskError, InputError, LabrigError, OutputExistsError, RecordError
from labrig.posix import sync_directory
from labrig.record.layout import MANIFEST, PROTOCOL
from labrig.record.manifest import read_manifest

# A Path keeps only one of the slashes; one letter and a colon are no scheme.
_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:(:|/)")
_ONE_SLASH = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/(?!/)")
# Those that hand on what stands in a file; others, such as `reference:`, do what a file from elsewhere tells them.
_SCHEMES = (
    "s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "adl", "oss", "sftp", "ssh", "ftp", "http", "https", "smb",
    "hdfs", "webhdfs", "webdav", "file", "local", "memory", "zip", "tar", "simplecache", "filecache",
)  # fmt: skip
_NOT_THERE = "check the address, that its server is up, and the access rights of this account"
_ZIP = "a run in a zip file is named zip::file:///folder/run.zip"


def is_url(place: str | Path) -> bool:
    """Return whether a place is a URL, even if it went through a Path."""
    return _URL.match(str(place)) is not None


def restore_url(place: str | Path) -> str:
    """Return a URL with the slashes that a Path removed from it."""
    return _ONE_SLASH.sub(lambda found: f"{found[1]}://" + ("/" if found[1] == "file" else ""), str(place))


def require_local(place: Path | str) -> Path:
    """Return a folder of this computer; refuse a URL when the command writes there. Raises `InputError`."""
    if is_url(place):
        url = restore_url(place)
        raise InputError(
            f"{url} is a URL, and this command writes on the local disk",
            f"copy a run first: labrig export {url} --format record --out data/runs/NAME",
        )
    return Path(place)


def fetch_run(url: str, into: Path) -> Path:
    """Copy the run behind a URL into a local folder and return its path.

    Raises
    ------
    RecordError
        When no run is there, or a file name in it leads out of it.
    InputError
        When the kind of URL is unknown, or its package is not installed.
    MachineError
        When the store cannot be read.
    """
    with store_errors("read", url):
        files, root = open_filesystem(url)
        names = files.find(root)
        if not names:
            raise RecordError(f"{url} is no run: nothing is there", _NOT_THERE)
        run = into / (PurePosixPath(root).name or "run")
        for name in names:
            parts = PurePosixPath(name.removeprefix(root).lstrip("/")).parts
            if not parts or any(part in {"..", "."} or "\\" in part for part in parts):
                raise RecordError(f"{url} holds {name!r}, which leads out of the run")
        files.get(root, str(run), recursive=True)
    return run


def require_apart(out: str, run: Path, *, record: bool) -> None:
    """Refuse to export a run into itself, or over another run.

    Parameters
    ----------
    record : bool
        Whether the record itself is copied. Only that may replace a run, and only a copy of the same run.

    Raises
    ------
    InputError
        When `out` is the run, or lies in it.
    OutputExistsError
        When `out` is a run that would no longer be one.
    """
    target = _find_local(out)
    if target is None:
        return
    if target.is_relative_to(run.resolve()):
        raise InputError(f"{out} lies in {run}, the run that is exported", "name a folder outside of it")
    if all((target / name).exists() for name in (MANIFEST, PROTOCOL)):
        if not record:
            raise OutputExistsError(
                f"{out} is a run, and tables are not written into it", "name another folder"
            )
        ours, theirs = read_manifest(run), read_manifest(target)
        if any(ours.get(key) != theirs.get(key) for key in ("run", "started", "seed", "protocol")):
            raise OutputExistsError(f"{out} is another run than {run}", "name another folder")


def _find_local(place: str) -> Path | None:
    """Return the folder of this computer that a place is, also as file://; None where it is elsewhere."""
    if not is_url(place):
        return Path(place).resolve()
    scheme, _, path = restore_url(place).partition("://")
    return Path(path).resolve() if scheme in {"file", "local"} else None


@contextmanager
def output_folder(out: str, *, force: bool) -> Iterator[Path]:
    """Give a folder to write into; its files go to `out`, a folder or URL, when the block ends without an error.

    Parameters
    ----------
    force : bool
        Replace files of the same names if `out` exists; other files in it stay.

    Raises
    ------
    OutputExistsError
        When it exists and `force` is not set; nothing has been written.
    DiskError
        When it cannot be written.
    """
    if is_url(out):
        with store_errors("write", out):
            files, root = open_filesystem(out)
            _require_free(out, exists=files.exists(root), force=force)
        with tempfile.TemporaryDirectory(prefix="labrig-") as folder:
            yield Path(folder)
            with store_errors("write", out):
                files.put(f"{folder}/", f"{root}/", recursive=True)
        return
    target = Path(out)
    if target.exists() and not target.is_dir():
        raise OutputExistsError(f"{out} is a file", "name a folder")
    _require_free(out, exists=target.exists(), force=force)
    with disk_errors(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        folder = tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent)
    try:
        yield Path(folder)
        with disk_errors(target):
            _move_files(Path(folder), target)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def copy_record(run: Path, folder: Path) -> None:
    """Copy a run with results and notes into a folder; links and hidden files are left out. Raises `DiskError`."""

    def leave_out(parent: str, names: list[str]) -> list[str]:
        return [name for name in names if name.startswith(".") or Path(parent, name).is_symlink()]

    with disk_errors(folder):
        shutil.copytree(run, folder, ignore=leave_out, dirs_exist_ok=True)


def _require_free(out: str, *, exists: bool, force: bool) -> None:
    if exists and not force:
        raise OutputExistsError(f"{out} exists already", "name another, or replace its files with --force")


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


def open_filesystem(url: str) -> tuple[fsspec.AbstractFileSystem, str]:
    """Return the file system of a URL, and the path of the URL in it.

    Raises
    ------
    InputError
        When the kind of URL is unknown, or its package is not installed.
    """
    for link in url.split("::"):
        scheme = link.partition(":")[0].lower()
        if scheme not in _SCHEMES and scheme in fsspec.available_protocols():
            raise InputError(
                f"{url} cannot be used: labrig does not follow {scheme}:", f"it knows {', '.join(_SCHEMES)}"
            )
    try:
        files, root = fsspec.core.url_to_fs(url)
    except ImportError as error:
        raise InputError(
            f"{url} cannot be used: {error}", "install what it names beside labrig, with pip"
        ) from error
    except ValueError as error:
        known = "s3:, gs:, sftp:, http: and zip: are some that fsspec knows"
        raise InputError(f"{url} cannot be used: {error}", known) from error
    return files, str(root).rstrip("/")


@contextmanager
def store_errors(doing: str, url: str) -> Iterator[None]:
    """Turn the errors of a store in the block into labrig's; `doing` is a verb: read, write.

    The library of each store raises errors of its own, which labrig cannot know. So every error but labrig's counts as
    one.
    """
    try:
        yield
    except LabrigError:
        raise
    except Exception as error:
        cause = getattr(error, "strerror", None) or str(error) or type(error).__name__
        hint = _ZIP if url.startswith("zip:") else _NOT_THERE
        # A store that cannot be reached is the machine's fault; a file that is not in it is the record's.
        is_missing = doing == "read" and isinstance(error, FileNotFoundError)
        raise (RecordError if is_missing else DiskError)(f"cannot {doing} {url}: {cause}", hint) from error
