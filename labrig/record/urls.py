"""Runs and exports outside the local disk: URLs that fsspec knows, such as those of an object store.

A live run, its results, pages and notes are written on the local disk only. A run behind a URL is copied to a temporary
folder and opened there, checked by its hashes like any other. An export is made in a temporary folder and moved into
place when it is complete.
"""

import hashlib
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path, PurePosixPath
from types import TracebackType

import fsspec

from labrig.durable import disk_errors
from labrig.errors import DiskError, InputError, OutputExistsError, RecordError
from labrig.posix import sync_directory
from labrig.record.digest import hash_file
from labrig.record.layout import MANIFEST, PROTOCOL
from labrig.record.manifest import read_document

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


def require_local_run(run: Path) -> None:
    """Refuse a URL when the command writes into the run.

    Raises
    ------
    InputError
    """
    if is_url(run):
        url = restore_url(run)
        raise InputError(
            f"{url} is a URL, and this command writes into the run",
            f"copy it first: labrig export {url} --record --out data/runs/{PurePosixPath(url).name or 'NAME'}",
        )


def require_local(folder: Path, option: str) -> None:
    """Refuse a URL when the command writes a run.

    Raises
    ------
    InputError
    """
    if is_url(folder):
        raise InputError(
            f"{option} {folder} is no folder of this computer; a live run writes on its local disk",
            "run into a local folder, then copy it: labrig export RUN --record --out URL",
        )


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
    with StoreErrors("read", url):
        files, root = open_filesystem(url)
        names = sorted(files.find(root))
        run = into / (PurePosixPath(root).name or "run")
        for name in names:
            local = run / _resolve_local_name(name, root, url)
            local.parent.mkdir(parents=True, exist_ok=True)
            files.get_file(name, str(local))
    if not names:
        raise RecordError(f"{url} is no run: nothing is there", _NOT_THERE)
    return run


def require_apart(out: str, run: str, *, record: bool) -> None:
    """Refuse to export a run into itself, or over another run.

    Parameters
    ----------
    out : str
        Where to: a folder or URL.
    run : str
        What is exported: a folder or URL.
    record : bool
        Whether the record itself is copied. Only that may replace a run, and only a copy of the same run.

    Raises
    ------
    InputError
        When `out` is the run, or lies in it.
    OutputExistsError
        When `out` is a run that would no longer be one.
    """
    target, source = _resolve_place(out), _resolve_place(run)
    if target == source or f"{target}/".startswith(f"{source}/"):
        raise InputError(f"{out} lies in {run}, the run that is exported", "name a folder outside of it")
    folder = Path(target)
    if is_url(target) or not all((folder / name).exists() for name in (MANIFEST, PROTOCOL)):
        return
    if not record:
        raise OutputExistsError(f"{out} is a run, and tables are not written into it", "name another folder")
    if not is_url(source) and _read_identity(folder) != _read_identity(Path(source)):
        raise OutputExistsError(f"{out} is another run than {run}", "name another folder")


def _resolve_place(place: str) -> str:
    """Return the absolute path of a folder, also of one behind a file: URL, or another URL as it is."""
    if not is_url(place):
        return str(Path(place).resolve())
    url = restore_url(place).rstrip("/")
    return str(Path(open_filesystem(url)[1]).resolve()) if url.startswith(("file:", "local:")) else url


def _read_identity(run: Path) -> tuple[object, ...]:
    manifest = read_document(run)
    return tuple(manifest.get(key) for key in ("run", "started", "seed", "hashes"))


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
        When it cannot be written, or is not what was sent when it is read back from a URL.
    """
    remote = is_url(out)
    _require_free(out, force)
    if remote:
        with tempfile.TemporaryDirectory(prefix="labrig-") as folder:
            yield Path(folder)
            _upload(Path(folder), out)
        return
    target = Path(out)
    with disk_errors(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        folder = tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent)
    try:
        yield Path(folder)
        with disk_errors(target):
            _move_files(Path(folder), target)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _require_free(out: str, force: bool) -> None:
    if is_url(out):
        with StoreErrors("look at", out):
            files, root = open_filesystem(out)
            exists = files.exists(root)
    else:
        exists = Path(out).exists()
        if exists and not Path(out).is_dir():
            raise OutputExistsError(f"{out} is a file", "name a folder")
    if exists and not force:
        raise OutputExistsError(f"{out} exists already", "name another, or replace its files with --force")


def _upload(folder: Path, url: str) -> None:
    with StoreErrors("write", url):
        files, root = open_filesystem(url)
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                name = f"{root}/{path.relative_to(folder).as_posix()}"
                files.makedirs(name.rpartition("/")[0], exist_ok=True)
                files.put_file(str(path), name)
                with files.open(name, "rb") as copy:
                    sha256 = hashlib.file_digest(copy, "sha256").hexdigest()
                if sha256 != hash_file(path):
                    raise DiskError(
                        f"{name} is not what was sent to {url}: its SHA-256 differs", "send it again"
                    )


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
        raise InputError(f"{url} cannot be used: {error}", _suggest_protocol(url)) from error
    return files, str(root).rstrip("/")


def _suggest_protocol(url: str) -> str:
    near = get_close_matches(url.partition(":")[0], fsspec.available_protocols(), 1)
    return (
        f"did you mean {near[0]}:? " if near else "s3:, gs:, sftp:, http: and zip: are some that fsspec knows"
    )


class StoreErrors:
    """Turns the errors of a store in its block into labrig's.

    The library of each store raises errors of its own, which labrig cannot know. So every `OSError` counts as one, and
    every error that is neither Python's nor labrig's.

    Parameters
    ----------
    doing : str
        What is done to the URL, as a verb: read, write.
    """

    def __init__(self, doing: str, url: str) -> None:
        self._what = f"cannot {doing} {url}"
        self._missing = RecordError if doing == "read" else DiskError
        self._hint = _ZIP if url.startswith("zip:") else _NOT_THERE

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None or error is None:
            return
        room = kind.__module__.partition(".")[0]
        if isinstance(error, OSError) or room not in {"builtins", "labrig"}:
            cause = (error.strerror if isinstance(error, OSError) else None) or str(error) or kind.__name__
            # A store that cannot be reached is the machine's fault; a file that is not in it is the record's.
            failure = self._missing if isinstance(error, FileNotFoundError) else DiskError
            raise failure(f"{self._what}: {cause}", self._hint) from error


def _resolve_local_name(name: str, root: str, url: str) -> Path:
    """Return the path of a remote file within the local run; a name that leads out of it is refused."""
    relative = PurePosixPath(name.removeprefix(root).lstrip("/"))
    if not relative.parts or any(part in {"..", "."} or "\\" in part for part in relative.parts):
        raise RecordError(f"{url} holds {name!r}, which leads out of the run")
    return Path(*relative.parts)
