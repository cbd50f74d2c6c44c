"""`specimen_file: NAME` in a gel of a protocol: what the specimen's file says, filled in as if the protocol held it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import get_args

from labrig.errors import InputError
from labrig.protocol.formatting import Plain, show
from labrig.protocol.model import Model
from labrig.protocol.sections import TrackedSpecimen
from labrig.protocol.specimen_file import SpecimenFile, list_specimen_folders, load_specimen
from labrig.protocol.tree import InputFault, KeyPath, Tree, file_format_error, locate_problems

KEY = "specimen_file"
_SECTION = "block"
_SHARED = ("name", "gelatin_percent")
"""Keys of a gel that its specimen's file gives too; a protocol may repeat them, and must not contradict them."""


def fill_in_specimens(tree: Tree, model: type[Model], folder: Path) -> Tree:
    """Return `tree` with what the specimen files say that its gels name; unchanged if they name none.

    Parameters
    ----------
    model : type
        The model of the protocol.
    folder : Path
        The folder of the protocol.

    Raises
    ------
    FileFormatError
        When a file is missing or malformed, or a gel contradicts it; each at its line.
    """
    folders = list_specimen_folders(folder)
    for path in [path for path in _list_gels(tree, model) if tree.holds((*path, KEY))]:
        tree = _fill_in(tree, path, folders)
    return tree


def _list_gels(tree: Tree, model: type[Model]) -> Iterator[KeyPath]:
    """Yield the key path of each gel that may name a specimen file."""
    for name, field in model.model_fields.items():
        kinds = (field.annotation, *get_args(field.annotation))
        if not any(isinstance(kind, type) and issubclass(kind, TrackedSpecimen) for kind in kinds):
            continue
        held = tree.value((name,))
        yield from ((name, index) for index in range(len(held))) if isinstance(held, list) else ((name,),)


def _fill_in(tree: Tree, path: KeyPath, folders: Sequence[Path]) -> Tree:
    key = (*path, KEY)
    position, named = tree.at(key).value, tree.value(key)
    try:
        if not isinstance(named, str):
            raise InputError(f"{KEY} is {show(named)}, expected the name of a specimen", "such as A1")
        specimen, sha256 = load_specimen(named, folders)
    except InputError as error:
        raise file_format_error([*tree.faults, *locate_problems(position, key, error)]) from error
    if faults := tuple(_find_contradictions(tree, path, specimen)):
        raise file_format_error([*tree.faults, *faults])
    gel = {name: value for name, value in tree.section(path).items() if name != KEY}
    filled = {name: getattr(specimen, name) for name in _SHARED}
    section = {**specimen.model_dump(mode="json"), "sha256": sha256}
    # Each key has a position of its own, so that a fault of another key of the gel keeps its line.
    held = replace(tree, values=_with_gel(tree, path, gel))
    for name, value in {**filled, _SECTION: section}.items():
        place = tree.at((*path, name)).value if name in gel else position
        held = held.put((*path, name), value, place)
    return held


def _with_gel(tree: Tree, path: KeyPath, gel: Mapping[str, Plain]) -> Plain:
    return tree.put(path, dict(gel), tree.at(path).value).values


def _find_contradictions(tree: Tree, path: KeyPath, specimen: SpecimenFile) -> Iterator[InputFault]:
    for name in _SHARED:
        key = (*path, name)
        given, said = tree.value(key), getattr(specimen, name)
        if tree.holds(key) and given != said:
            message = f"{name} is {show(given)}, and the file of specimen {specimen.name} says {show(said)}"
            yield InputFault(
                tree.at(key).value, key, message, f"delete {name} here, or name another specimen"
            )
    if tree.holds((*path, _SECTION)):
        message = f"{_SECTION} is given, and {KEY} gives it too; only one of the two is allowed"
        yield InputFault(tree.at((*path, _SECTION)).key, (*path, _SECTION), message, f"delete {_SECTION}")
