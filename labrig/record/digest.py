"""The SHA-256 of a file, or of its beginning."""

import hashlib
from pathlib import Path

from labrig.errors import RecordError
from labrig.input_file import open_file
from labrig.record.layout import COPY_HINT

_CHUNK_BYTES = 2**20


def hash_file(path: Path, length: int | None = None) -> str:
    """Return the SHA-256 of a file, or of its first `length` bytes. Raises `RecordError` if it cannot be read."""
    try:
        with open_file(path) as file:
            if length is None:
                return hashlib.file_digest(file, "sha256").hexdigest()
            digest = hashlib.sha256()
            while length > 0 and (chunk := file.read(min(length, _CHUNK_BYTES))):
                digest.update(chunk)
                length -= len(chunk)
            return digest.hexdigest()
    except OSError as error:
        raise RecordError(f"cannot read {path}: {error.strerror}", COPY_HINT) from error
