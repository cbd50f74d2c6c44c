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
        if isinstance(here, list):
            here = dict(enumerate(here)).get(int(part))
        else:
            here = here.get(part) if isinstance(here, Mapping) else None
        found = here.get("frame", found) if isinstance(here, Mapping) else found
    return found


def _order(value: Any) -> Any:
    """Return a document without its stamp, and at each level what has lists of pictures before what has none."""
    if isinstance(value, list | tuple):
        return [_order(item) for item in value]
    if not isinstance(value, Mapping):
        return value
    members = {
        key: bool(one) if key in _SENTENCES and isinstance(one, str) else _order(one)
        for key, one in value.items()
        if key not in _STAMP
    }
    return dict(sorted(members.items(), key=lambda member: not _has_pictures(member[1])))


def _has_pictures(value: object) -> bool:
    rows = [row for row in value if isinstance(row, Mapping)] if isinstance(value, list) else []
    return any("frame" in row or any(map(_has_pictures, row.values())) for row in rows)
