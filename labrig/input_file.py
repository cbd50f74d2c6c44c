"""What labrig takes from a file that anybody may have made: a regular file, of bounded size; JSON of bounded depth.

Every file is opened here, so that a named pipe holds up no command and no device fills the memory. What a file of one
kind must hold beyond that is said where that kind is read; an `OSError` of this module has its reason in `strerror`,
as those of the operating system have.
"""

import errno
import json
import math
import os
import stat
from io import BufferedReader
from json.decoder import JSONDecoder
from pathlib import Path
from typing import Any

MAX_DOCUMENT_BYTES = 2**24
"""The largest manifest, calibration, mask, template or state file; the largest ever seen has a hundredth of it."""

MAX_RESULT_BYTES = 2**28
"""The largest result; 18,000 pictures, ten minutes of a camera, take a tenth of it."""

MAX_LOG_BYTES = 2**32
"""The largest file of lines or of CAN frames; a bus at its limit takes two hours to fill it."""

MAX_DEPTH = 64
"""Levels of lists and mappings in JSON; labrig writes less than ten."""

_TOO_DEEP = f"nested deeper than {MAX_DEPTH} levels"
_LONGEST_INT = 300  # digits; a double holds 308


def open_file(path: Path) -> BufferedReader:
    """Open a regular file for reading; links to one are followed, anything else is not opened at all.

    Raises
    ------
    OSError
        When it cannot be opened, or is a folder, a named pipe, a device or a socket.
    """
    try:
        _require_regular(path.stat(), path)
        # Whatever takes its place now must not be waited for.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except ValueError as error:  # a NUL in the name
        raise OSError(errno.EINVAL, "the name holds a NUL", str(path)) from error
    try:
        _require_regular(os.fstat(descriptor), path)
        return os.fdopen(descriptor, "rb")
    except OSError:
        os.close(descriptor)
        raise


def read_file(path: Path, max_bytes: int = MAX_DOCUMENT_BYTES) -> bytes:
    """Return the content of a regular file of bounded size; of one that grows meanwhile, what it held at first.

    Raises
    ------
    OSError
        As `open_file`, or when it is larger.
    """
    with open_file(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > max_bytes:
            raise OSError(errno.EFBIG, f"it has {size} bytes, at most {max_bytes} are read", str(path))
        return file.read(size)


def _require_regular(found: os.stat_result, path: Path) -> None:
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, "it is no regular file, but a pipe, a device or a socket", str(path))


def parse_json(content: bytes, *, finite: bool = True) -> object:
    """Return the value of a JSON text in UTF-8 with at most 64 levels.

    Parameters
    ----------
    finite : bool
        Refuse NaN and numbers beyond a double; without it, a model says where they stand.

    Raises
    ------
    ValueError
        When it is no JSON (`json.JSONDecodeError`), nested deeper, or holds a number that is not finite.
    """
    try:
        text = content.decode(json.detect_encoding(content))
        value = (_DECODER if finite else _ANY_NUMBER).decode(text)
    except RecursionError as error:
        raise ValueError(_TOO_DEEP) from error
    # No deeper than it has brackets: most lines need no second look.
    if content.count(b"[") + content.count(b"{") > MAX_DEPTH:
        _check_depth(value)
    if b"\\ud" in content.lower():  # an escape of half a character, which no file or terminal takes
        json.dumps(value, ensure_ascii=False).encode()
    return value


def _check_depth(value: Any) -> None:
    level = [value]
    for _ in range(MAX_DEPTH):
        level = [
            item
            for node in level
            for item in (node.values() if isinstance(node, dict) else node)
            if isinstance(item, dict | list)
        ]
        if not level:
            return
    raise ValueError(_TOO_DEEP)


def _parse_int(text: str) -> int | float:
    return int(text) if len(text) <= _LONGEST_INT else _parse_float(text)


def _parse_float(text: str) -> float:
    number = float(text)
    return number if math.isfinite(number) else _refuse_number(text)


def _refuse_number(text: str) -> float:
    raise ValueError(f"the number {text[:20]} is not finite")


_ANY_NUMBER = JSONDecoder(parse_int=_parse_int)
_DECODER = JSONDecoder(parse_float=_parse_float, parse_int=_parse_int, parse_constant=_refuse_number)
