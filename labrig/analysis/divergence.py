"""Whether two results of one run agree: in the words, and with the tolerances, of a replay."""

from collections.abc import Mapping
from typing import Any

from labrig.record.agreement import Agreement

# Members about the result itself and its request always differ.
_STAMP = frozenset({
    "created", "damage", "inputs", "overrides", "parent", "provenance", "schema_version", "settings",
})  # fmt: skip
# Sentences repeat settings and numbers; only their presence counts.
_SENTENCES = frozenset({"cause", "reason", "unmeasured"})


def compare_results(old: Mapping[str, Any], new: Mapping[str, Any]) -> Agreement:
    """Compare a result with an older one of the same run.

    Values measured in single pictures are compared first, in their order, then the values computed from them. Of a
    sentence only its presence is compared.

    Parameters
    ----------
    old, new : Mapping
        Documents of both results.
    """
    agreement, before, now = Agreement(), _order(old), _order(new)
    for key in dict.fromkeys((*before, *now)):
        agreement.compare(key, before.get(key), now.get(key))
    return agreement


def find_frame(path: str, document: Mapping[str, Any]) -> int | None:
    """Return the picture that a path is about: the `frame` of the innermost item on the path that has one."""
    found: int | None = None
    here: Any = document
    for part in path.split("."):
        if isinstance(here, Mapping):
            here = here.get(part)
        elif isinstance(here, list) and part.isdecimal() and int(part) < len(here):
            here = here[int(part)]
        else:
            return found
        if isinstance(here, Mapping) and isinstance(here.get("frame"), int):
            found = here["frame"]
    return found


def _order(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return a document without its stamp; at each level the lists of pictures come first, then what has such lists."""
    members = {
        key: bool(value) if key in _SENTENCES and isinstance(value, str) else _order_nested(value)
        for key, value in document.items()
        if key not in _STAMP
    }
    return dict(sorted(members.items(), key=lambda item: _rank(item[1])))


def _order_nested(value: object) -> object:
    if isinstance(value, Mapping):
        return _order(value)
    return [_order_nested(item) for item in value] if isinstance(value, list | tuple) else value


def _rank(value: object) -> int:
    if _is_of_pictures(value):
        return 0
    rows = value if isinstance(value, list) else []
    within = (part for row in rows if isinstance(row, Mapping) for part in row.values())
    return 1 if any(map(_is_of_pictures, within)) else 2


def _is_of_pictures(value: object) -> bool:
    rows = value if isinstance(value, list) else []
    return bool(rows) and all(isinstance(row, Mapping) and "frame" in row for row in rows)
