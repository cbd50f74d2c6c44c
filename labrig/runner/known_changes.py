"""Changes of labrig by which the replay of an older record differs from it, each with its line of the changelog.

They are the defects that were mended without a protocol key. Each was found by replaying records of older code with
the code before the change, which reproduced the line to the last bit, and with the code after it.

An entry that explained too much would hide a defect. So it names the kind of the recorded line, all that may differ in
it, and, where the change came before another one of protocol or rig file, a key that every record made since has and
this one must not have; the rest of the line must be the same. What no entry explains is a finding. Nor has a
difference of commands an entry, unless an event tells beforehand which way they go.
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from labrig.devices.replayed.comparison import DifferingLines

Line = Mapping[str, Any]

_PLACE = (
    r"the needle's end is (?P<in_plane>[\d.]+) mm from the target in the plane, and between (?P<interval>[\d.]+ and "
    r"[\d.]+) mm in space \(95 %\), and (?P<tolerance>[\d.]+) mm are allowed"
    r"(?:; one camera does not see what is out of its plane, and most of the uncertainty comes from [^;]+)?"
)
_DEPTH = (
    r"(?:by its width and length in the picture the needle's end is [\d.]+ mm (?:behind|before) the plane \(standard "
    r"deviation [\d.]+ mm\), which its path does not explain; )?"
)
_FORMER_REFUSAL = (
    r"no path of \d+ arcs? leads to the target, obstacles or not"
    r"|no path of \d+ arcs? leads to the target without pointing too far aside"
    r"|too long: the shortest path is [\d.]+ mm, and [\d.]+ mm are allowed"
    r"|blocked by obstacle \d+: it cuts \d+ % of the paths that lead to the target"
)
_REFUSAL = r"no path found with up to \d+ arcs? and [\d.]+ mm.*"
_LARGEST = r"(?P<before>.*; one camera does not see what is out of its plane, and most of the uncertainty comes from )"
_OTHERS = (
    r"(?:the roll zero|the lag of the bevel|the needle's wandering out of the plane|the start"
    r"|the place in the picture)"
)
# The last digits of a number that linear algebra rounds otherwise.
_ROUNDING = 1e-12
# By so much longer three standing axes were watched when a rig was opened, in every record that was tried.
_WATCHED_S = 0.3


@dataclass(frozen=True)
class KnownChange:
    """A change by which events of older records differ.

    Attributes
    ----------
    version, changelog : str
        The section of the changelog, and the sentences in it.
    kind : str
        The kind of the event; empty: every kind.
    keys : frozenset of str or None
        The keys of the event that may differ; None: all.
    explains : callable
        Whether the recorded and the new event differ as the change has it.
    lacks : tuple of str
        Path of a key that the resolved `protocol`, or `rig` file, of records made since has, and older ones have not.
        The section that holds it must be there. Empty: nothing in a record tells on which side of the change it is.
    """

    version: str
    changelog: str
    kind: str
    keys: frozenset[str] | None
    explains: Callable[[Line, Line], bool]
    lacks: tuple[str, ...]


def find_known_change(differing: DifferingLines | None, settings: Mapping[str, Any]) -> KnownChange | None:
    """Return the change that explains the first difference of a replay; None if none is known to.

    Parameters
    ----------
    differing : DifferingLines or None
        The recorded and the new line; None if something else than a line differs.
    settings : Mapping
        `protocol` and `rig` of the record, as it keeps them.
    """
    if differing is None or differing.what != "event":
        return None
    return next((change for change in KNOWN_CHANGES if _fits(change, differing, settings)), None)


def _fits(change: KnownChange, differing: DifferingLines, settings: Mapping[str, Any]) -> bool:
    old, new = differing.recorded, differing.now
    others = frozenset[str]() if change.keys is None else (old.keys() | new.keys()) - change.keys
    return (
        (not change.kind or old.get("kind") == change.kind)
        and _lacks(settings, change.lacks)
        and all(key in old and key in new and old[key] == new[key] for key in others)
        and change.explains(old, new)
    )


def _lacks(settings: Mapping[str, Any], path: tuple[str, ...]) -> bool:
    """Return whether the section that the path leads to is there, and its last key is not; True without a path."""
    if not path:
        return True
    section: Any = settings
    for name in path[:-1]:
        section = section.get(name) if isinstance(section, Mapping) else None
    return isinstance(section, Mapping) and path[-1] not in section


def _match_texts(
    key: str, recorded: str, now: str, changed: str | None = None
) -> Callable[[Line, Line], bool]:
    """Return whether a text was of one form and is of another: groups of a name are the same, but for `changed`."""

    def match(old: Line, new: Line) -> bool:
        before, after = re.fullmatch(recorded, str(old.get(key))), re.fullmatch(now, str(new.get(key)))
        if before is None or after is None:
            return False
        names = before.groupdict().keys() | after.groupdict().keys()
        differing = {name for name in names if before.groupdict().get(name) != after.groupdict().get(name)}
        return differing == ({changed} if changed else set())

    return match


def _adds_error_of_lag(old: Line, new: Line) -> bool:
    before, after = old.get("torsion"), new.get("torsion")
    if not isinstance(before, Mapping) or not isinstance(after, Mapping) or "error" in before:
        return False
    return "error" in after and {**before, "error": after["error"]} == after


def _turns_other_way(old: Line, new: Line) -> bool:
    return math.isclose(abs(new["to_rad"] - old["to_rad"]), math.tau, abs_tol=1e-9) and old.get(
        "overshoot_rad", 0.0
    ) == -new.get("overshoot_rad", 0.0)


def _rounds_otherwise(old: Any, new: Any) -> bool:
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        return old.keys() == new.keys() and all(_rounds_otherwise(old[key], new[key]) for key in old)
    if isinstance(old, list) and isinstance(new, list):
        return len(old) == len(new) and all(map(_rounds_otherwise, old, new))
    if isinstance(old, float) and isinstance(new, float):
        return math.isclose(old, new, rel_tol=_ROUNDING, abs_tol=_ROUNDING)
    return bool(old == new)


def _begins_later(old: Line, new: Line) -> bool:
    return math.isclose(new["t_s"] - old["t_s"], _WATCHED_S, abs_tol=1e-9)


_UNRELEASED = "0.1.0, unreleased"
_ENDING = frozenset({"exit_status", "outcome", "stop", "cause"})

KNOWN_CHANGES: tuple[KnownChange, ...] = (
    KnownChange(
        _UNRELEASED,
        "The interval of an insertion's error in space began above the true error in 21 of 40 runs of "
        "`protocols/insertion.yaml`. The end is known by the shaft in the last picture and by the estimate on the way "
        "together, the error bar of a shaft whose bend has just swung over is as wide as its reading is off, and a "
        "needle that was steered to its target may be there.",
        "trial_stop",
        _ENDING,
        _match_texts("cause", _PLACE, _PLACE, changed="interval"),
        lacks=("protocol", "target", "sd_mm"),
    ),
    KnownChange(
        _UNRELEASED,
        "A needle whose wandering out of the plane was stated too small was pulled back into the plane. The last "
        "picture weighs what is stated against larger wanderings, and reads depths of more than 10 mm to their full "
        "size.",
        "trial_stop",
        _ENDING,
        _match_texts("cause", _DEPTH + _PLACE, _DEPTH + _PLACE, changed="interval"),
        lacks=("protocol", "target", "sd_mm"),
    ),
    KnownChange(
        _UNRELEASED,
        "The place of the target was named too rarely as the largest source of an insertion's uncertainty: its "
        "standard deviation along one axis was compared with others over all axes.",
        "trial_stop",
        frozenset({"cause"}),
        _match_texts("cause", _LARGEST + _OTHERS, _LARGEST + "the place of the target"),
        lacks=(),
    ),
    KnownChange(
        _UNRELEASED,
        "What the error of a measured lag leaves out of the plane depended on its largest standard deviation instead "
        "of that at the depth of each turn.",
        "trial_start",
        frozenset({"torsion"}),
        _adds_error_of_lag,
        lacks=("protocol", "target", "sd_mm"),
    ),
    KnownChange(
        _UNRELEASED,
        "The directions of the bevel's turns were chosen as if a lag were off by the same angle at every depth. An "
        "error of the lag that grows with the depth counts as such, and some turns go the other way round to the same "
        "direction of the bevel.",
        "flip",
        frozenset({"to_rad", "overshoot_rad"}),
        _turns_other_way,
        lacks=("protocol", "target", "sd_mm"),
    ),
    KnownChange(
        _UNRELEASED,
        "The reason why there is no path states what was searched and found, and nothing that was not proven: it named "
        "the shortest path where a shorter one exists, and shares of paths that an obstacle cuts without their first "
        "arcs.",
        "plan",
        frozenset({"refusal"}),
        _match_texts("refusal", _FORMER_REFUSAL, _REFUSAL),
        lacks=("protocol", "planner", "staging"),
    ),
    KnownChange(
        _UNRELEASED,
        "Linear algebra rounds alike on all x86-64 processors with AVX2: a replay was not identical on a processor of "
        "another maker.",
        "",
        None,
        _rounds_otherwise,
        lacks=("rig", "world", "needle", "torsion_lag_deg"),
    ),
    KnownChange(
        _UNRELEASED,
        "An axis counts as standing still only after the time in which its encoder would show a creep of 1 rpm.",
        "run_start",
        frozenset({"t_s"}),
        _begins_later,
        lacks=("rig", "axes", "insertion", "driver"),
    ),
)
"""Entries, of which the first that fits a difference is named."""
