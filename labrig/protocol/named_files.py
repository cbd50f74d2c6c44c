"""What the files say that a protocol names, a needle's design and the specimens, filled in as if the protocol held it.

It is filled into the tree before that is validated. So a fault of a value is reported at the line of the file's name,
and the protocol that is validated, run and recorded holds the values: a record needs no file outside of it.
"""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias, get_args

from labrig.errors import InputError
from labrig.input_file import read_file
from labrig.protocol.design_file import NeedleDesign, load_design
from labrig.protocol.formatting import KeyPath, Plain, show
from labrig.protocol.model import Model
from labrig.protocol.sections import NeedleDesignSection, TrackedSpecimen
from labrig.protocol.specimen_file import list_specimen_folders, load_specimen
from labrig.protocol.tree import InputFault, Tree, file_format_error, locate_problems
from labrig.protocol.yaml_tree import MAX_BYTES

TellDesign: TypeAlias = Callable[[NeedleDesign, str, str], Mapping[str, Any]]
"""(design, name of its file as given, SHA-256 of the file) -> what is filled into the needle."""

_REACH = "name a file below this folder or beside it, relative to this file: ../designs/needle.json"


def fill_in_design(tree: Tree, folder: Path, tell: TellDesign) -> Tree:
    """Return `tree` with the numbers of the design file that its needle names; unchanged if it names none.

    Parameters
    ----------
    folder : Path
        The folder of the file that the tree was read from.
    tell : callable
        What the needle takes of a design.

    Raises
    ------
    FileFormatError
        When the name is out of reach, the needle contradicts the design, or the file is none; each at its line.
    """

    def read(named: Plain) -> Mapping[str, Any]:
        path = _resolve_name(named, folder)
        return tell(load_design(path), str(named), hashlib.sha256(read_file(path, MAX_BYTES)).hexdigest())

    return _fill_in(tree, ("needle",), "design_file", read)


def tell_protocol(design: NeedleDesign, name: str, sha256: str) -> Mapping[str, Any]:
    """Return what the needle of a protocol takes of its design."""
    known = {"file": name, "sha256": sha256, **design.model_dump(), **design.tube.model_dump()}
    return {
        "diameter_mm": design.diameter_mm,
        "design_radius_mm": design.radius_mm,
        "design": {key: known[key] for key in NeedleDesignSection.model_fields},
    }


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
    for gel in list(_list_gels(tree, model)):
        tree = _fill_in(tree, gel, "specimen_file", lambda named: _tell_specimen(named, folders))
    return tree


def _list_gels(tree: Tree, model: type[Model]) -> Iterator[KeyPath]:
    """Yield the key path of each gel that may name a specimen file."""
    for name, field in model.model_fields.items():
        kinds = (field.annotation, *get_args(field.annotation))
        if not any(isinstance(kind, type) and issubclass(kind, TrackedSpecimen) for kind in kinds):
            continue
        held = tree.value((name,))
        yield from ((name, index) for index in range(len(held))) if isinstance(held, list) else ((name,),)


def _tell_specimen(named: Plain, folders: Sequence[Path]) -> Mapping[str, Any]:
    if not isinstance(named, str):
        raise InputError(f"specimen_file is {show(named)}, expected the name of a specimen", "such as A1")
    specimen, sha256 = load_specimen(named, folders)
    block = {**specimen.model_dump(mode="json"), "sha256": sha256}
    return {"name": specimen.name, "gelatin_percent": specimen.gelatin_percent, "block": block}


def _fill_in(tree: Tree, section: KeyPath, key: str, read: Callable[[Plain], Mapping[str, Any]]) -> Tree:
    """Return `tree` with what a file says that a section names under a key.

    The section may repeat what the file says. Each value has a position of its own, the name's if the section does not
    give it, so that a fault of another key keeps its line.
    """
    name = (*section, key)
    if not tree.holds(name):
        return tree
    named, position = tree.value(name), tree.at(name).value
    try:
        told = read(named)
    except InputError as error:
        raise file_format_error([*tree.faults, *locate_problems(position, name, error)]) from error
    kept = {own: value for own, value in tree.section(section).items() if own != key}
    faults = [
        InputFault(
            tree.at((*section, own)).value,
            (*section, own),
            f"{own} is {show(kept[own])}, and {key} {named} says {show(value)}",
            f"delete {own}, or {key}",
        )
        for own, value in told.items()
        if own in kept and kept[own] != value
    ]
    if faults:
        raise file_format_error([*tree.faults, *faults])
    filled = replace(tree, values=tree.put(section, kept, position).values)
    for own, value in told.items():
        place = tree.at((*section, own)).value if own in kept else position
        filled = filled.put((*section, own), value, place)
    return filled


def _resolve_name(named: Plain, folder: Path) -> Path:
    """Return the design file of this name; links are resolved before its reach is judged."""
    if not isinstance(named, str) or not named or not named.isprintable():
        raise InputError(f"design_file is {show(named)}, expected the name of a design file", _REACH)
    path, reach = folder / named, folder.resolve().parent
    if Path(named).is_absolute():
        raise InputError(f"design_file is {named}, expected a relative name", _REACH)
    if not path.resolve().is_relative_to(reach):
        raise InputError(
            f"design_file is {named}, which leaves the folder above the one that it is named in", _REACH
        )
    if not path.is_file():
        raise InputError(
            f"design_file is {named}, and {path} is not a file", "a run of protocols/design.yaml writes one"
        )
    return path
