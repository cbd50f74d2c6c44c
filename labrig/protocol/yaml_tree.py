"""YAML file -> tree of values with positions, without a model; a search over runs needs no more."""

import difflib
from codecs import BOM_UTF8
from collections.abc import Mapping
from pathlib import Path

from labrig.errors import FileFormatError
from labrig.input_file import open_file
from labrig.protocol.formatting import Plain
from labrig.protocol.tree import InputFault, Position, Tree, file_format_error
from labrig.protocol.yaml_text import read_tree

_SUFFIXES = frozenset({".yaml", ".yml", ".json"})
MAX_BYTES = 256 * 1024  # a hundred times a long protocol; ruamel.yaml reads about 150 kB a second


def load_yaml_values(path: Path | str) -> dict[str, Plain]:
    """Return the values of a YAML file of any kind, as in JSON.

    Raises
    ------
    FileFormatError
        When it is not YAML, or holds no mapping.
    """
    return _require_faultless(load_tree(Path(path)))


def _require_faultless(tree: Tree) -> dict[str, Plain]:
    if tree.faults:
        raise file_format_error(list(tree.faults))
    return tree.section(())


def load_tree(path: Path) -> Tree:
    """Return the mapping in a file, with positions. Raises `FileFormatError`."""
    content = _read_bytes(path).removeprefix(BOM_UTF8)
    try:
        return read_tree(_decode(content, str(path)), str(path))
    except FileFormatError as error:
        if path.suffix in _SUFFIXES:
            raise
        raise _file_error(path, "this is not a YAML file", _hint_at_files(path.parent / "x.yaml")) from error


def require_kind(tree: Tree, others: Mapping[str, tuple[str, str]]) -> None:
    """Refuse a file of another kind in one sentence, instead of naming every missing key.

    Parameters
    ----------
    others : mapping of str to (str, str)
        Key that only files of another kind have -> a message that names this kind, and a hint.

    Raises
    ------
    FileFormatError
    """
    for key, (message, hint) in others.items():
        if tree.holds((key,)):
            raise file_format_error([InputFault(tree.at((key,)).key, (key,), message, hint)])


def _read_bytes(path: Path) -> bytes:
    try:
        with open_file(path) as file:
            content = file.read(MAX_BYTES + 1)
    except FileNotFoundError as error:
        raise _file_error(path, "there is no such file", _hint_at_files(path)) from error
    except IsADirectoryError as error:
        raise _file_error(
            path, "this is a folder, expected a YAML file", _hint_at_files(path / "x")
        ) from error
    except OSError as error:
        message = f"cannot be read: {error.strerror}"
        raise _file_error(path, message, "check the name and the permissions") from error
    if len(content) > MAX_BYTES:
        message = f"larger than {MAX_BYTES // 1024} kB, expected a file written by hand"
        raise _file_error(path, message, "is this the right file?")
    return content


def _decode(content: bytes, source: str) -> str:
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        before = content[: error.start].decode("utf-8")
        position = Position(source, before.count("\n") + 1, len(before) - before.rfind("\n"))
        message = f"the byte 0x{content[error.start]:02x} is not UTF-8, expected text in UTF-8"
        raise file_format_error(
            [InputFault(position, (), message, "save the file as UTF-8 in your editor")]
        ) from error


def _file_error(path: Path, message: str, hint: str) -> FileFormatError:
    return file_format_error([InputFault(Position(str(path)), (), message, hint)])


def _hint_at_files(path: Path) -> str:
    """Return a hint: the file that `path` probably means, or the YAML files beside it."""
    if not path.parent.is_dir():
        return f"the folder {path.parent} does not exist"
    names = sorted(file.name for file in path.parent.iterdir() if file.suffix in _SUFFIXES)
    if meant := difflib.get_close_matches(path.name, names, n=1):
        return f"did you mean {path.parent / meant[0]}?"
    if names:
        return f"YAML files there: {', '.join(names[:10])}"
    return f"{'this folder' if path.parent == Path() else path.parent} holds no YAML file"
