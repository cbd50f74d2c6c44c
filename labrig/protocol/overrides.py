"""`--set dotted.key=value`: values put into a tree before it is validated."""

from collections.abc import Sequence
from dataclasses import replace

from labrig.errors import FileFormatError, InputError
from labrig.protocol.formatting import Plain, show
from labrig.protocol.tree import InputFault, Position, Tree
from labrig.protocol.yaml_text import MAX_DEPTH, compose, resolve_scalar

SET = Position("--set")


def apply_overrides(tree: Tree, overrides: Sequence[str]) -> Tree:
    """Return `tree` with each `dotted.key=value` put in; a later override replaces an earlier one.

    A value is a YAML scalar, or any YAML if it starts with a bracket, a brace or a quote. An index names the entry of a
    list: `specimens.0.name=A`. Unknown keys are found when the model is validated.
    """
    for text in overrides:
        tree = _apply_override(tree, text)
    return tree


def _apply_override(tree: Tree, text: str) -> Tree:
    dotted, equals, raw = text.partition("=")
    path = tuple(dotted.strip().split("."))
    if not equals or not all(path) or len(path) > MAX_DEPTH:
        hint = "for example --set insertion.length_mm=30"
        fault = InputFault(SET, (), f"{show(text)} is not an override, expected dotted.key=value", hint)
        return replace(tree, faults=(*tree.faults, fault))
    try:
        return tree.put(path, _read_value(raw.strip()), SET)
    except FileFormatError as error:
        shown = show(raw.strip())
        faults = [InputFault(SET, path, f"{fault.message}: {shown}", fault.hint) for fault in error.problems]
    except InputError as error:
        faults = [InputFault(SET, path, error.message)]
    return replace(tree, faults=(*tree.faults, *faults))


def _read_value(text: str) -> Plain:
    if text[:1] not in {"[", "{", '"', "'"}:
        return resolve_scalar(text)
    composed = compose(text, str(SET))
    if composed.faults:
        raise FileFormatError(tuple(fault.problem() for fault in composed.faults))
    return composed.values
