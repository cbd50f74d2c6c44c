"""The digest of labrig's own code, so that a record says which code made it, also where there is no commit."""

import hashlib
import os
from collections.abc import Iterator
from functools import cache
from pathlib import Path

_PACKAGE = Path(__file__).parents[1]
_CODE = frozenset({".py", ".jinja", ".html", ".css", ".js", ".svg"})
_NO_CODE = ("examples/", "manual/")
"""What a wheel holds beside the code; in a checkout the first stands elsewhere."""


@cache
def digest_sources(package: Path = _PACKAGE) -> str:
    """Return the SHA-256 of the code and the templates of a package; it takes 20 ms once.

    It is that of what `sha256sum` prints for the files, which are named from the package's folder, in the order of
    their names by byte: the same for a checkout, a wheel and an installation of it.
    """
    listing = hashlib.sha256()
    for name in sorted(_list_code(package)):
        with open(os.path.join(package, name), "rb") as file:  # noqa: PTH118, PTH123 - 400 files; pathlib takes twice as long
            listing.update(f"{hashlib.sha256(file.read()).hexdigest()}  {name}\n".encode())
    return listing.hexdigest()


def _list_code(package: Path) -> Iterator[str]:
    """Yield the names of the files with code, relative to the package."""
    for folder, inner, files in os.walk(package):
        inner[:] = [name for name in inner if name != "__pycache__" and not name.startswith(".")]
        above = os.path.relpath(folder, package).replace(os.sep, "/")
        names = files if above == "." else [f"{above}/{name}" for name in files]
        yield from (
            name
            for name in names
            if os.path.splitext(name)[1] in _CODE and not name.startswith(_NO_CODE)  # noqa: PTH122
        )
