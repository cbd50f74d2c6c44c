"""The SHA-256 of a file, or of its beginning."""

import hashlib
import os
from pathlib import Path

from labrig.errors import RecordError
from labrig.input_file import MAX_LOG_BYTES, open_file
from labrig.record.layout import COPY_HINT, RAW_PICTURES

_CHUNK_BYTES = 2**20


def hash_file(path: Path, length: int | None = None) -> str:
    """Return the SHA-256 of a file, or of its first `length` bytes. Raises `RecordError` if it cannot be read."""
    try:
        with open_file(path) as file:
            size = os.fstat(file.fileno()).st_size
            if size > MAX_LOG_BYTES and path.name != RAW_PICTURES:
                raise RecordError(f"{path} has {size} bytes, at most {MAX_LOG_BYTES} are read", COPY_HINT)
            if length is None:
                return hashlib.file_digest(file, "sha256").hexdigest()
            digest = hashlib.sha256()
            while length > 0 and (chunk := file.read(min(length, _CHUNK_BYTES))):
                digest.update(chunk)
                length -= len(chunk)
            return digest.hexdigest()
    except OSError as error:
        raise RecordError(f"cannot read {path}: {error.strerror}", COPY_HINT) from error
