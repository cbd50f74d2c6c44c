"""`needle: {needle_id, design_file}`: the numbers of a design file, put where the protocol would have them written.

It happens before validation and in the tree, so that a fault of the numbers stands at the line of the file name, and so
that what is validated, run and recorded holds the numbers themselves: a record needs no file outside of it.
"""

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from labrig.errors import FileFormatError, InputError, Problem
from labrig.protocol.design_file import NeedleDesign, load_design
from labrig.protocol.tree import Fault, Node, Tree, branch, file_format_error, moved, node_from_plain

KEY = "design_file"
_REACH = "name a file below this folder or beside it, relative to this file: ../designs/needle.json"


@dataclass(frozen=True)
class Filling:
    """What a design file fills in of a needle: its keys, which may not stand beside the file, and their values.

    `values` takes the design, the file's name as it was given, and its SHA-256.
    """

    keys: tuple[str, ...]
    values: Callable[[NeedleDesign, str, str], dict[str, object]]


def with_design(tree: Tree, folder: Path | None, filling: Filling) -> Tree:
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
    needle = tree.root.children.get("needle")
    named = None if needle is None else needle.children.get(KEY)
    if needle is None or named is None or (named.kind == "scalar" and named.scalar is None):
        return tree
    if faults := tuple(_beside(needle, filling.keys)):
        raise file_format_error([*tree.faults, *faults])
    try:
        values = _values(named, folder, filling)
    except InputError as error:
        raise file_format_error([*tree.faults, *_faults(named, error)]) from error
    children = {key: child for key, child in needle.children.items() if key != KEY}
    children |= {key: moved(node_from_plain(each, named.place), named.place) for key, each in values.items()}
    resolved = branch("mapping", needle.place, children, needle.key_place)
    root = branch("mapping", tree.root.place, {**tree.root.children, "needle": resolved}, tree.root.key_place)
    return Tree(root, tree.faults)


def _beside(needle: Node, keys: tuple[str, ...]) -> Iterator[Fault]:
    for key in keys:
        if (beside := needle.children.get(key)) is not None and beside.shown() != "null":
            message = f"{key} is {beside.shown()}, and {KEY} says it too; one of the two may stand"
            yield Fault(beside.key, ("needle", key), message, f"delete {key}, or {KEY}")


def _faults(named: Node, error: InputError) -> Iterator[Fault]:
    problems = (
        error.problems if isinstance(error, FileFormatError) else (Problem("", error.message, error.hint),)
    )
    for problem in problems:
        message = f"{problem.where}: {problem.message}" if problem.where else problem.message
        yield Fault(named.place, ("needle", KEY), message, problem.hint)


def _values(named: Node, folder: Path | None, filling: Filling) -> dict[str, object]:
    path = _in_reach(named, folder)
    return filling.values(load_design(path), str(named.scalar), _sha256(path))


def _of_protocol(design: NeedleDesign, name: str, sha256: str) -> dict[str, object]:
    return {
        "diameter_mm": design.diameter_mm,
        "design_radius_mm": design.radius_mm,
        "design": {"file": name, "sha256": sha256, **_details(design)},
    }


def _of_scenario(design: NeedleDesign, _name: str, _sha256: str) -> dict[str, object]:
    return {
        "diameter_mm": design.diameter_mm,
        "radius_mm": design.radius_mm,
        "radius_low_mm": design.radius_low_mm,
        "radius_high_mm": design.radius_high_mm,
    }


IN_PROTOCOL = Filling(("diameter_mm", "design_radius_mm", "design"), _of_protocol)
IN_SCENARIO = Filling(("diameter_mm", "radius_mm", "radius_low_mm", "radius_high_mm"), _of_scenario)


def _details(design: NeedleDesign) -> dict[str, object]:
    return {
        "radius_low_mm": design.radius_low_mm,
        "radius_high_mm": design.radius_high_mm,
        "inner_diameter_mm": design.tube.inner_diameter_mm,
        "link_length_mm": design.tube.link_length_mm,
        "clearance_mm": design.clearance_mm,
        "beta_cut_deg": design.beta_cut_deg,
        "basis": design.basis,
    }


def _in_reach(named: Node, folder: Path | None) -> Path:
    """Return the file that is named; links are followed before the reach is judged."""
    if not isinstance(named.scalar, str) or not named.scalar or not named.scalar.isprintable():
        raise InputError(f"{KEY} is {named.shown()}, expected the name of a design file", _REACH)
    if folder is None:
        raise InputError(
            f"{KEY} is {named.scalar}, and what names it stands in no file that it could be relative to"
        )
    name = Path(named.scalar)
    if name.is_absolute():
        raise InputError(f"{KEY} is {named.scalar}, expected a relative name", _REACH)
    path, reach = folder / name, folder.resolve().parent
    if not path.resolve().is_relative_to(reach):
        raise InputError(
            f"{KEY} is {named.scalar}, which leaves the folder above the one that it is named in", _REACH
        )
    if not path.is_file():
        raise InputError(
            f"{KEY} is {named.scalar}, and {path} is no file", "write one with `labrig design --out FILE`"
        )
    return path


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
