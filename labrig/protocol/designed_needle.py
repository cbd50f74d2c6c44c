"""`needle: {needle_id, design_file}`: the numbers of a design file, filled in as if the protocol held them.

They are filled into the tree before it is validated. So a fault of a number is reported at the line of the file name,
and the protocol that is validated, run and recorded holds the numbers: a record needs no file outside of it.
"""

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from labrig.errors import InputError
from labrig.input_file import read_file
from labrig.protocol.design_file import NeedleDesign, load_design
from labrig.protocol.formatting import Plain, show
from labrig.protocol.sections import NeedleDesignSection
from labrig.protocol.tree import InputFault, Tree, file_format_error, locate_problems
from labrig.protocol.yaml_tree import MAX_BYTES

KEY = "design_file"
_DESIGN = ("needle", KEY)
_REACH = "name a file below this folder or beside it, relative to this file: ../designs/needle.json"


@dataclass(frozen=True)
class Filling:
    """What a design file fills in: keys of the needle, which must not be given beside the file, and their values.

    `values` takes the design, the file's name as it was given, and its SHA-256.
    """

    keys: tuple[str, ...]
    values: Callable[[NeedleDesign, str, str], dict[str, Plain]]


def fill_in_design(tree: Tree, folder: Path, filling: Filling) -> Tree:
    """Return `tree` with the numbers of the design file that its needle names; unchanged if it names none.

    Parameters
    ----------
    folder : Path
        The folder of the protocol.
    filling : Filling

    Raises
    ------
    FileFormatError
        When the name is out of reach, a number is given beside it, or the file is no design; each at its line.
    """
    named = tree.value(_DESIGN)
    if named is None:
        return tree
    if faults := tuple(_find_duplicates(tree, filling.keys)):
        raise file_format_error([*tree.faults, *faults])
    position = tree.at(_DESIGN).value
    try:
        path = _resolve_name(named, folder)
        values = filling.values(load_design(path), str(named), _sha256(path))
    except InputError as error:
        raise file_format_error([*tree.faults, *locate_problems(position, _DESIGN, error)]) from error
    needle = {key: value for key, value in tree.section(_DESIGN[:1]).items() if key != KEY}
    tree = replace(tree, values={**tree.section(()), _DESIGN[0]: needle})
    for key, value in values.items():
        tree = tree.put((_DESIGN[0], key), value, position)
    return tree


def _find_duplicates(tree: Tree, keys: tuple[str, ...]) -> Iterator[InputFault]:
    for path in ((_DESIGN[0], key) for key in keys):
        if tree.holds(path):
            key, shown = path[1], show(tree.value(path))
            message = f"{key} is {shown}, and {KEY} gives it too; only one of the two is allowed"
            yield InputFault(tree.at(path).key, path, message, f"delete {key}, or {KEY}")


def _fill_protocol(design: NeedleDesign, name: str, sha256: str) -> dict[str, Plain]:
    known = {"file": name, "sha256": sha256, **design.model_dump(), **design.tube.model_dump()}
    return {
        "diameter_mm": design.diameter_mm,
        "design_radius_mm": design.radius_mm,
        "design": {key: known[key] for key in NeedleDesignSection.model_fields},
    }


IN_PROTOCOL = Filling(("diameter_mm", "design_radius_mm", "design"), _fill_protocol)


def _resolve_name(named: Plain, folder: Path) -> Path:
    """Return the file of this name; links are resolved before its reach is judged."""
    if not isinstance(named, str) or not named or not named.isprintable():
        raise InputError(f"{KEY} is {show(named)}, expected the name of a design file", _REACH)
    name = Path(named)
    if name.is_absolute():
        raise InputError(f"{KEY} is {named}, expected a relative name", _REACH)
    path, reach = folder / name, folder.resolve().parent
    if not path.resolve().is_relative_to(reach):
        raise InputError(
            f"{KEY} is {named}, which leaves the folder above the one that it is named in", _REACH
        )
    if not path.is_file():
        raise InputError(
            f"{KEY} is {named}, and {path} is not a file",
            "a run of protocols/design.yaml writes one",
        )
    return path


def _sha256(path: Path) -> str:
    return hashlib.sha256(read_file(path, MAX_BYTES)).hexdigest()
