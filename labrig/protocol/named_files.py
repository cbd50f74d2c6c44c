"""What the files say that a protocol names, a needle's design and the specimens, filled in as if the protocol held it.

It is filled into the tree before that is validated. So a fault of a value is reported at the line of the file's name,
and the protocol that is validated, run and recorded holds the values: a record needs no file outside of it.
"""

import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from labrig.errors import FileFormatError, InputError
from labrig.input_file import read_file
from labrig.protocol.design_file import load_design
from labrig.protocol.specimen_file import list_specimen_folders, load_specimen
from labrig.protocol.tree import KeyPath, Plain, Tree, file_format_error, show
from labrig.protocol.yaml_text import MAX_BYTES

_REACH = "name a file below this folder or beside it, relative to this file: ../designs/needle.json"

_Read = Callable[[Path, Plain], Mapping[str, Any]]


def fill_in_files(tree: Tree, folder: Path) -> Tree:
    """Return a protocol's tree with what the files say that its needle and its gels name.

    Parameters
    ----------
    folder : Path
        The folder of the protocol.

    Raises
    ------
    FileFormatError
        When a file is missing, malformed or out of reach, or the protocol contradicts it; each at its line.
    """
    for section in _list_sections(tree):
        for key, read in _READERS.items():
            if tree.holds((*section, key)):
                tree = _fill_in(tree, section, key, partial(read, folder))
    return tree


def _list_sections(tree: Tree) -> Iterator[KeyPath]:
    """Yield the path of each section at the top, and of each in a list there."""
    for name, held in tree.section(()).items():
        yield from ((name, index) for index in range(len(held))) if isinstance(held, list) else ((name,),)


def _fill_in(tree: Tree, section: KeyPath, key: str, read: Callable[[Plain], Mapping[str, Any]]) -> Tree:
    """Return `tree` with what a file says that a section names under a key.

    The section may repeat what the file says. Each value has a position of its own, the name's if the section does not
    give it, so that a fault of another key keeps its line.
    """
    name = (*section, key)
    named, position = tree.value(name), tree.at(name)
    try:
        told = read(named)
    except FileFormatError as error:
        problems = [tree.fault(name, f"{each.where}: {each.message}", each.hint) for each in error.problems]
        raise file_format_error([*tree.faults, *problems]) from error
    except InputError as error:
        raise file_format_error([*tree.faults, tree.fault(name, error.message, error.hint)]) from error
    kept = {own: value for own, value in tree.section(section).items() if own != key}
    faults = [
        tree.fault(
            (*section, own),
            f"{own} is {show(kept[own])}, and {key} {named} says {show(value)}",
            f"delete {own}, or {key}",
        )
        for own, value in told.items()
        if own in kept and kept[own] != value
    ]
    if faults:
        raise file_format_error([*tree.faults, *faults])
    places = {tuple(map(str, (*section, own))): position for own in told}
    filled = tree.put(section, {**kept, **told}, position)
    return replace(tree, values=filled.values, positions={**places, **tree.positions})


def _read_design(folder: Path, named: Plain) -> Mapping[str, Any]:
    """Return what a needle takes of its design file; links are resolved before the reach of its name is judged."""
    if not isinstance(named, str) or not named or not named.isprintable():
        raise InputError(f"design_file is {show(named)}, expected the name of a design file", _REACH)
    path = folder / named
    if Path(named).is_absolute() or not path.resolve().is_relative_to(folder.resolve().parent):
        raise InputError(f"design_file is {named}, which leaves the folder above this file's", _REACH)
    if not path.is_file():
        raise InputError(
            f"design_file is {named}, and {path} is not a file", "a run of protocols/design.yaml writes one"
        )
    design = load_design(path)
    return {
        "diameter_mm": design.tube.outer_diameter_mm,
        "design_radius_mm": design.radius_mm,
        "design": {
            "file": named,
            "sha256": hashlib.sha256(read_file(path, MAX_BYTES)).hexdigest(),
            "radius_low_mm": design.radius_low_mm,
            "radius_high_mm": design.radius_high_mm,
            "link_length_mm": design.tube.link_length_mm,
        },
    }


def _read_specimen(folder: Path, named: Plain) -> Mapping[str, Any]:
    """Return what a gel takes of its specimen file."""
    if not isinstance(named, str):
        raise InputError(f"specimen_file is {show(named)}, expected the name of a specimen", "such as A1")
    specimen, sha256 = load_specimen(named, list_specimen_folders(folder))
    block = {**specimen.model_dump(mode="json"), "sha256": sha256}
    return {"name": specimen.name, "gelatin_percent": specimen.gelatin_percent, "block": block}


_READERS: Mapping[str, _Read] = {"design_file": _read_design, "specimen_file": _read_specimen}
"""Key that names a file -> what reads it."""
