"""`needle: {needle_id, design_file}`: the numbers of a design file, put where the protocol would have them written.

It happens before validation and in the tree, so that a fault of the numbers stands at the line of the file name, and so
that what is validated, run and recorded holds the numbers themselves: a record needs no file outside of it.
"""

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from labrig.errors import FileFormatError, InputError, Problem
from labrig.protocol.design_file import NeedleDesign, load_design
from labrig.protocol.formatting import Plain, show
from labrig.protocol.tree import InputFault, Position, Tree, file_format_error

KEY = "design_file"
_DESIGN = ("needle", KEY)
_REACH = "name a file below this folder or beside it, relative to this file: ../designs/needle.json"


@dataclass(frozen=True)
class Filling:
    """What a design file fills in of a needle: its keys, which may not stand beside the file, and their values.

    `values` takes the design, the file's name as it was given, and its SHA-256.
    """

    keys: tuple[str, ...]
    values: Callable[[NeedleDesign, str, str], dict[str, Plain]]


def fill_in_design(tree: Tree, folder: Path | None, filling: Filling) -> Tree:
    """Return `tree` with the numbers of the design file that its needle names; unchanged where it names none.

    Parameters
    ----------
    folder : Path or None
        Where the protocol stands; None for a text that stands in no file.
    filling : Filling

    Raises
    ------
    FileFormatError
        When the name leaves its reach, a number stands beside it, or the file is no design; each at its line.
    """
    named = tree.value(_DESIGN)
    if named is None:
        return tree
    if faults := tuple(_beside(tree, filling.keys)):
        raise file_format_error([*tree.faults, *faults])
    position = tree.at(_DESIGN).value
    try:
        values = _values(named, folder, filling)
    except InputError as error:
        raise file_format_error([*tree.faults, *_faults(position, error)]) from error
    needle = {key: each for key, each in tree.section(_DESIGN[:1]).items() if key != KEY}
    tree = replace(tree, values={**tree.section(()), _DESIGN[0]: needle})
    for key, each in values.items():
        tree = tree.put((_DESIGN[0], key), each, position)
    return tree


def _beside(tree: Tree, keys: tuple[str, ...]) -> Iterator[InputFault]:
    for path in ((_DESIGN[0], key) for key in keys):
        if tree.holds(path):
            key, shown = path[1], show(tree.value(path))
            message = f"{key} is {shown}, and {KEY} says it too; one of the two may stand"
            yield InputFault(tree.at(path).key, path, message, f"delete {key}, or {KEY}")


def _faults(position: Position, error: InputError) -> Iterator[InputFault]:
    problems = (
        error.problems if isinstance(error, FileFormatError) else (Problem("", error.message, error.hint),)
    )
    for problem in problems:
        message = f"{problem.where}: {problem.message}" if problem.where else problem.message
        yield InputFault(position, _DESIGN, message, problem.hint)


def _values(named: Plain, folder: Path | None, filling: Filling) -> dict[str, Plain]:
    path = _in_reach(named, folder)
    return filling.values(load_design(path), str(named), _sha256(path))


def _of_protocol(design: NeedleDesign, name: str, sha256: str) -> dict[str, Plain]:
    return {
        "diameter_mm": design.diameter_mm,
        "design_radius_mm": design.radius_mm,
        "design": {"file": name, "sha256": sha256, **_details(design)},
    }


IN_PROTOCOL = Filling(("diameter_mm", "design_radius_mm", "design"), _of_protocol)


def _details(design: NeedleDesign) -> dict[str, Plain]:
    return {
        "radius_low_mm": design.radius_low_mm,
        "radius_high_mm": design.radius_high_mm,
        "inner_diameter_mm": design.tube.inner_diameter_mm,
        "link_length_mm": design.tube.link_length_mm,
        "clearance_mm": design.clearance_mm,
        "beta_cut_deg": design.beta_cut_deg,
        "basis": design.basis,
    }


def _in_reach(named: Plain, folder: Path | None) -> Path:
    """Return the file that is named; links are followed before the reach is judged."""
    if not isinstance(named, str) or not named or not named.isprintable():
        raise InputError(f"{KEY} is {show(named)}, expected the name of a design file", _REACH)
    if folder is None:
        raise InputError(
            f"{KEY} is {named}, and what names it stands in no file that it could be relative to"
        )
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
            f"{KEY} is {named}, and {path} is no file", "write one with `labrig design --out FILE`"
        )
    return path


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
