"""`--set dotted.key=value`: single values put into a tree before it is validated."""

from collections.abc import Sequence
from dataclasses import replace

from labrig.errors import FileFormatError, InputError
from labrig.protocol.tree import Fault, KeyPath, Node, Place, Tree, branch, moved
from labrig.protocol.words import show, show_key
from labrig.protocol.yaml_text import MAX_DEPTH, compose, resolve_scalar

SET = Place("--set")


def overridden(tree: Tree, overrides: Sequence[str]) -> Tree:
    """Return `tree` with each `dotted.key=value` put in, the later over the earlier.

    A value is a YAML scalar; one that starts with a bracket, a brace or a quote is YAML in full. An index
    names the entry of a list: `specimens.0.name=A`. Unknown keys are found when the model is validated.
    """
    for text in overrides:
        tree = _with_one(tree, text)
    return tree


def put(root: Node, path: KeyPath, value: Node) -> Node:
    """Return `root` with `value` at `path`.

    Raises
    ------
    InputError
        The path leads through a scalar or to an entry that a list does not have.
    """
    if not path:
        return value
    key = _key_in(root, path[0])
    child = root.children.get(key, Node("scalar", value.place, key_place=value.place))
    children = {**root.children, key: put(child, path[1:], value)}
    return branch("sequence" if root.kind == "sequence" else "mapping", root.place, children, root.key_place)


def _key_in(node: Node, part: str | int) -> str | int:
    if node.kind == "mapping" or (node.kind == "scalar" and node.scalar is None):
        return part
    if node.kind == "scalar":
        raise InputError(f"{show_key(part)} cannot be set inside {node.shown()}, which is no section")
    count = len(node.children)
    if not str(part).isdecimal() or int(part) >= count:
        raise InputError(f"{show_key(part)} names no entry of this list, expected 0 to {count - 1}")
    return int(part)


def _with_one(tree: Tree, text: str) -> Tree:
    dotted, equals, raw = text.partition("=")
    path = tuple(dotted.strip().split("."))
    if not equals or not all(path) or len(path) > MAX_DEPTH:
        hint = "for example --set insertion.length_mm=30"
        fault = Fault(SET, (), f"{show(text)} is no override, expected dotted.key=value", hint)
        return replace(tree, faults=(*tree.faults, fault))
    try:
        return replace(tree, root=put(tree.root, path, _value(raw)))
    except FileFormatError as error:
        faults = [Fault(SET, path, problem.message, problem.hint) for problem in error.problems]
        return replace(tree, faults=(*tree.faults, *faults))
    except InputError as error:
        return replace(tree, faults=(*tree.faults, Fault(SET, path, error.message)))


def _value(raw: str) -> Node:
    text = raw.strip()
    if text[:1] in {"[", "{", '"', "'"}:
        composed = compose(text, str(SET))
        if composed.faults:
            raise FileFormatError(tuple(fault.problem() for fault in composed.faults))
        return moved(composed.root, SET)
    return Node("scalar", SET, resolve_scalar(text), key_place=SET)
