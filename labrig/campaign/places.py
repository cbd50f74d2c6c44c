"""Where the files of a campaign lie: a folder of this computer, or a URL that fsspec knows."""

from abc import ABC, abstractmethod
from pathlib import Path

from labrig.durable import disk_errors, find_temporaries, write_atomically
from labrig.errors import DiskError, InputError, LockedError, RecordError
from labrig.input_file import MAX_RESULT_BYTES, read_file
from labrig.record.layout import LOCK
from labrig.record.lock import FileLock
from labrig.record.urls import StoreErrors, is_url, open_filesystem, restore_url

_ANOTHER = "let that one end, or name another folder with --out"


class Place(ABC):
    """A flat folder of files that are written once and whole. Its text is what the user named it."""

    @abstractmethod
    def make(self) -> None:
        """Make the folder if it is not there. Raises `DiskError`."""

    @abstractmethod
    def list_names(self) -> list[str]:
        """Return the names of its files and folders, sorted. Raises `DiskError`."""

    @abstractmethod
    def read(self, name: str) -> bytes:
        """Return the content of a file. Raises `RecordError` or `DiskError`."""

    @abstractmethod
    def write(self, name: str, content: bytes, *, replace: bool) -> None:
        """Write a file as a whole.

        Parameters
        ----------
        replace : bool
            Whether a file of that name is expected, and replaced.

        Raises
        ------
        LockedError
            When a file of that name is there unexpectedly: another process writes here.
        DiskError
            When it cannot be written; nothing is left of it.
        """

    @abstractmethod
    def close(self) -> None:
        """Let others write here."""


class _Folder(Place):
    """A folder of this computer, locked for this process."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with disk_errors(path):
            path.mkdir(parents=True, exist_ok=True)
        self._lock = FileLock(path / LOCK).acquire("labrig campaign")
        with disk_errors(path):
            for left in find_temporaries(path):
                left.unlink()

    def __str__(self) -> str:
        return str(self._path)

    def make(self) -> None:
        """Leave the folder as it is: it was made for its lock."""

    def list_names(self) -> list[str]:
        with disk_errors(self._path):
            return sorted(path.name for path in self._path.iterdir() if path.name != LOCK)

    def read(self, name: str) -> bytes:
        path = self._path / name
        try:
            return read_file(path, MAX_RESULT_BYTES)
        except OSError as error:
            raise RecordError(f"cannot read {path}: {error.strerror}", "check the disk") from error

    def write(self, name: str, content: bytes, *, replace: bool) -> None:
        path = self._path / name
        if path.exists() and not replace:
            raise _make_refusal(str(path))
        write_atomically(path, content)

    def close(self) -> None:
        self._lock.release()


class _RemoteFolder(Place):
    """A folder at a URL, where nothing can be locked: a second writer is noticed by the part that it has written."""

    def __init__(self, url: str) -> None:
        self._url = restore_url(url).rstrip("/")
        if self._url.rpartition("::")[2].startswith("memory:"):
            raise InputError(
                f"{self._url} is the memory of this process, and the table would be lost with it",
                "name a folder, or a URL that stays, such as s3://BUCKET/NAME",
            )
        self._files, self._root = open_filesystem(self._url)

    def __str__(self) -> str:
        return self._url

    def make(self) -> None:
        with StoreErrors("make", self._url):
            self._files.makedirs(self._root, exist_ok=True)

    def list_names(self) -> list[str]:
        with StoreErrors("look at", self._url):
            self._files.invalidate_cache()
            if not self._files.exists(self._root):
                return []
            names = self._files.ls(self._root, detail=False)
        return sorted(str(name).rstrip("/").rpartition("/")[2] for name in names)

    def read(self, name: str) -> bytes:
        with StoreErrors("read", f"{self._url}/{name}"):
            content: bytes = self._files.cat_file(f"{self._root}/{name}")
        return content

    def write(self, name: str, content: bytes, *, replace: bool) -> None:
        """Write a file by one request, which object stores carry out as a whole, and compare what has arrived."""
        path = f"{self._root}/{name}"
        with StoreErrors("write", f"{self._url}/{name}"):
            try:
                self._files.pipe_file(path, content, mode="overwrite" if replace else "create")
            except FileExistsError as error:
                raise _make_refusal(f"{self._url}/{name}") from error
            if self._files.cat_file(path) != content:
                self._files.rm_file(path)
                raise DiskError(f"{self._url}/{name} is not what was sent", "send it again")

    def close(self) -> None:
        """Do nothing: nothing is locked."""


def _make_refusal(name: str) -> LockedError:
    return LockedError(f"{name} is there already: another process writes this campaign", _ANOTHER)


def open_place(place: str) -> Place:
    """Return a place for one writer.

    Parameters
    ----------
    place : str
        A folder, made if it is not there, or a URL.

    Raises
    ------
    LockedError
        When another process of this computer writes in the folder.
    InputError
        When the kind of URL is unknown, or forgets what is written, or its package is not installed.
    DiskError
        When the folder cannot be made.
    """
    return _RemoteFolder(place) if is_url(place) else _Folder(Path(place))
