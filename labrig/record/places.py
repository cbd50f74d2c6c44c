"""Where runs and exports may stand beside the local disk: URLs that fsspec knows, such as an object store's.

A live run writes on the local disk alone. A run behind a URL is copied to a temporary folder and opened there,
checked by its hashes like any other; an export is made in a temporary folder, and put in its place when it is whole.
"""

import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

import fsspec

from labrig.errors import DiskError, InputError, OutputExistsError, RecordError
from labrig.posix import sync_directory
from labrig.record.durable import disk_errors

# A Path keeps one of the two slashes; one letter and a colon are a drive of Windows.
_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:(:|/)")
_NOT_THERE = "check the address, and the access rights of this account"


def is_url(place: str | Path) -> bool:
    """Return whether a place is a URL, also one that a Path has been made of."""
    return _URL.match(str(place)) is not None


def require_local(folder: Path, option: str) -> None:
    """Refuse a URL where a run is written.

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
    """Copy the run behind a URL into a local folder and return where it stands.

    Raises
    ------
    RecordError
        When there is no run, or a name in it leads out of it.
    InputError
        When the kind of URL is not known.
    """
    files, root = _filesystem(url)
    try:
        names = sorted(files.find(root))
        run = into / (PurePosixPath(root).name or "run")
        for name in names:
            local = run / _relative(name, root, url)
            local.parent.mkdir(parents=True, exist_ok=True)
            files.get_file(name, str(local))
    except OSError as error:
        raise RecordError(f"cannot read {url}: {error.strerror or error}", _NOT_THERE) from error
    if not names:
        raise RecordError(f"{url} is no run: nothing is there", _NOT_THERE)
    return run


@contextmanager
def output_folder(out: str, *, force: bool) -> Iterator[Path]:
    """Give a folder to write into; its files are put to `out`, a folder or URL, when the block has ended well.

    Parameters
    ----------
    force : bool
        Replace files of the same names where `out` exists; other files in it stay.

    Raises
    ------
    OutputExistsError
        When it exists, and is not forced; nothing has been written.
    DiskError
        When it cannot be written.
    """
    remote = is_url(out)
    _require_free(out, force)
    if remote:
        with tempfile.TemporaryDirectory(prefix="labrig-") as folder:
            yield Path(folder)
            _put(Path(folder), out)
        return
    target = Path(out)
    with disk_errors(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        folder = tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent)
    try:
        yield Path(folder)
        with disk_errors(target):
            _move(Path(folder), target)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _require_free(out: str, force: bool) -> None:
    if is_url(out):
        files, root = _filesystem(out)
        try:
            exists = files.exists(root)
        except OSError as error:
            raise DiskError(f"cannot look at {out}: {error.strerror or error}", _NOT_THERE) from error
    else:
        exists = Path(out).exists()
        if exists and not Path(out).is_dir():
            raise OutputExistsError(f"{out} is a file", "name a folder")
    if exists and not force:
        raise OutputExistsError(f"{out} exists already", "name another, or replace its files with --force")


def _put(folder: Path, url: str) -> None:
    files, root = _filesystem(url)
    try:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                name = f"{root}/{path.relative_to(folder).as_posix()}"
                files.makedirs(name.rpartition("/")[0], exist_ok=True)
                files.put_file(str(path), name)
    except OSError as error:
        raise DiskError(f"cannot write {url}: {error.strerror or error}", _NOT_THERE) from error


def _move(folder: Path, target: Path) -> None:
    """Put files into their places, each by one rename; a link that stands there is replaced, not followed."""
    for path in sorted(folder.rglob("*")):
        place = target / path.relative_to(folder)
        if path.is_file():
            place.parent.mkdir(parents=True, exist_ok=True)
            path.replace(place)
    sync_directory(target)


def _filesystem(url: str) -> tuple[fsspec.AbstractFileSystem, str]:
    try:
        files, root = fsspec.core.url_to_fs(url)
    except (ValueError, ImportError, OSError) as error:
        raise InputError(f"{url} cannot be used: {error}", "see the protocols that fsspec knows") from error
    return files, str(root).rstrip("/")


def _relative(name: str, root: str, url: str) -> Path:
    """Return where a file of a remote run belongs in the local one; a name that leads elsewhere is refused."""
    relative = PurePosixPath(name.removeprefix(root).lstrip("/"))
    if not relative.parts or any(part in {"..", "."} or "\\" in part for part in relative.parts):
        raise RecordError(f"{url} holds {name!r}, which leads out of the run")
    return Path(*relative.parts)
