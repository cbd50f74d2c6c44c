"""Values of a file together with where each of them stands, and the faults found on the way."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

from labrig.errors import FileFormatError, Problem
from labrig.protocol.words import show, show_key

Scalar: TypeAlias = str | int | float | bool | None
Plain: TypeAlias = Scalar | list["Plain"] | dict[str, "Plain"]
KeyPath: TypeAlias = tuple[str | int, ...]

MAX_FAULTS = 50  # more than this nobody reads


@dataclass(frozen=True)
class Place:
    """A position: `source` is a file or an option, line and column count from 1 (0: it has no lines)."""

    source: str
    line: int = 0
    column: int = 0

    def __str__(self) -> str:
        return f"{self.source}:{self.line}:{self.column}" if self.line else self.source


@dataclass(frozen=True)
class Fault:
    """One fault before it becomes a `Problem`: its place, its key path, what is wrong, what to do."""

    place: Place
    path: KeyPath
    message: str
    hint: str = ""

    def problem(self) -> Problem:
        """Return the fault as the user reads it, `where` being `file:line:column key.path`."""
        dotted = ".".join(show_key(part) for part in self.path)
        return Problem(f"{self.place} {dotted}".rstrip(), self.message, self.hint)


@dataclass(frozen=True)
class Node:
    """One value of a file: a scalar, or a mapping or sequence with its children.

    Parameters
    ----------
    kind : {"scalar", "mapping", "sequence"}
    place : Place
        Where the value starts.
    scalar : str, int, float, bool or None
        The value of a scalar.
    children : mapping of key or index to Node
        The entries of a mapping or sequence.
    key_place : Place, optional
        Where the key before the value starts; the value's own place in sequences and at the top.
    size, height : int
        Values below and including this one, and levels, aliases expanded.
    """

    kind: Literal["scalar", "mapping", "sequence"]
    place: Place
    scalar: Scalar = None
    children: Mapping[str | int, "Node"] = field(default_factory=dict)
    key_place: Place | None = None
    size: int = 1
    height: int = 1

    @property
    def key(self) -> Place:
        """Where the entry starts: at its key, if it has one."""
        return self.key_place or self.place

    def shown(self) -> str:
        """Return the value in a few words for a message."""
        if self.kind == "mapping":
            return "a section (keys and values)"
        if self.kind == "sequence" and self.size > 6:
            return f"a list of {len(self.children)}"
        if self.kind == "sequence":
            return "[" + ", ".join(child.shown() for child in self.children.values()) + "]"
        return show(self.scalar)


@dataclass(frozen=True)
class Tree:
    """What was read from one source: its top mapping and the faults that did not stop the reading."""

    root: Node
    faults: tuple[Fault, ...] = ()


def branch(
    kind: Literal["mapping", "sequence"],
    place: Place,
    children: Mapping[str | int, Node],
    key: Place | None = None,
) -> Node:
    """Return a mapping or sequence node with its size and height counted."""
    size = 1 + sum(child.size for child in children.values())
    height = 1 + max((child.height for child in children.values()), default=0)
    return Node(kind, place, None, children, key, size, height)


def plain(node: Node) -> Plain:
    """Return the values of `node` without their places, as JSON would hold them."""
    if node.kind == "scalar":
        return node.scalar
    if node.kind == "sequence":
        return [plain(child) for child in node.children.values()]
    return {str(key): plain(child) for key, child in node.children.items()}


def node_from_plain(values: object, place: Place) -> Node:
    """Return values that stand in no file as a node; all of it stands at `place`."""
    if isinstance(values, Mapping):
        return branch(
            "mapping", place, {str(key): node_from_plain(each, place) for key, each in values.items()}
        )
    if isinstance(values, list | tuple):
        return branch("sequence", place, {i: node_from_plain(each, place) for i, each in enumerate(values)})
    if values is None or isinstance(values, str | int | float):
        return Node("scalar", place, values)
    return Node("scalar", place, str(values))


def moved(node: Node, place: Place) -> Node:
    """Return `node` with all of it standing at `place`."""
    children = {key: moved(child, place) for key, child in node.children.items()}
    return replace(node, place=place, key_place=place, children=children)


def half_characters(node: Node, path: KeyPath = ()) -> Iterator[Fault]:
    """Yield each key and text that holds half a surrogate pair, which no encoding can write.

    They come from escapes in double quotes and from options that are not valid in the terminal's encoding.
    """
    texts = [node.scalar, *(path[-1:])]
    if any(isinstance(text, str) and any("\ud800" <= each <= "\udfff" for each in text) for text in texts):
        hint = "write the character itself, in UTF-8"
        yield Fault(node.place, path, f"{node.shown()} or its key holds bytes that are no character", hint)
    for key, child in node.children.items():
        yield from half_characters(child, (*path, key))


def file_format_error(faults: Iterable[Fault]) -> FileFormatError:
    """Return one error of all faults, in the order of their places, each once."""
    ordered = sorted(dict.fromkeys(faults), key=lambda f: (f.place.line == 0, f.place.line, f.place.column))
    problems = tuple(fault.problem() for fault in ordered)
    if len(problems) > MAX_FAULTS:
        rest = Problem(ordered[0].place.source, f"and {len(problems) - MAX_FAULTS} more problems like these")
        problems = (*problems[:MAX_FAULTS], rest)
    return FileFormatError(problems)
