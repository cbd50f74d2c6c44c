"""Keys and values of a campaign that would be taken and mean nothing: they are refused before the first task."""

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import accumulate

from labrig.errors import Problem
from labrig.protocol.model import Conflict

_SEED = "seed"
_NEED_PICTURES = (
    "max_current_ma",
    "ask_when",
    "stop_when",
    "sentinel",
    "rig.can",
    "rig.faults",
    "rig.calibration.template",
    "rig.calibration.mask",
    "rig.recording.fsync_period_s",
    "rig.recording.least_free_mb",
    "rig.world.needle.bevel_deg",
    "rig.world.needle.link_mm",
    "rig.world.resistance",
    "rig.world.force_sensor_mv_per_n",
    "rig.world.light",
    "rig.world.blur_px",
    "rig.world.noise_sd",
    "rig.world.bubbles_per_specimen",
    "rig.world.ignores",
    "rig.world.markers",
)
_CAMERA = "rig.camera"
_OF_LENS = ("rig.camera.width_px", "rig.camera.height_px")
"""Must be those of the world's lens, which counts without pictures too."""


def find_key_conflicts(sections: Mapping[str, Iterable[str]], depth: str) -> Iterable[Conflict]:
    """Yield keys that a campaign decides itself, and without pictures those that only pictures and devices need.

    Parameters
    ----------
    sections : Mapping
        The dotted keys of each section of the campaign file.
    depth : str
        How deep it is simulated.
    """
    for section, keys in sections.items():
        for key in keys:
            if key == _SEED:
                yield Conflict(
                    section,
                    "seed is drawn by the campaign for each repetition, from its own seed",
                    "leave it out; more repetitions are more seeds",
                )
            elif depth == "world" and needs_pictures(key):
                yield Conflict(
                    section,
                    f"{key} changes nothing at depth: world, which has no pictures, no devices and no record",
                    "say depth: rig, or leave it out",
                )


def find_double_keys(sections: Mapping[str, Iterable[str]]) -> Iterable[Conflict]:
    """Yield keys that stand in two sections, and those that a later section replaces as part of a larger one.

    Parameters
    ----------
    sections : Mapping
        The dotted keys of each section, in the order in which they take effect.
    """
    order = list(sections)
    given = [(key, section) for section, keys in sections.items() for key in keys]
    last = dict(given)
    for key, section in given:
        for whole in accumulate(key.split("."), "{}.{}".format):
            later = last.get(whole, section)
            if order.index(later) > order.index(section):
                second = f"in {later}" if whole == key else f"{whole} in {later}"
                yield Conflict(later, f"{key} is in {section} and {second}", "give it in one of them")


def _holds(key: str, other: str) -> bool:
    return other == key or other.startswith(f"{key}.")


def needs_pictures(key: str) -> bool:
    """Return whether a key changes nothing in a run that is computed without pictures, bus and record."""
    if key.startswith(f"{_CAMERA}."):
        return key not in _OF_LENS
    return any(_holds(known, key) for known in _NEED_PICTURES)


def find_repeated_values(vary: Mapping[str, Sequence[object]]) -> Iterable[Conflict]:
    """Yield values that are given twice for a key, as 20 and 20.0: their arms would be the same."""
    for key, values in vary.items():
        counts = Counter(map(_name_value, values))
        for name, count in counts.items():
            if count > 1:
                yield Conflict(f"vary.{key}", f"{key} has the value {name} more than once", "give it once")


def _name_value(value: object) -> str:
    """Return a value as text, the same for numbers that are equal, and for a text that reads as that number."""
    text = value if isinstance(value, str) else json.dumps(value)
    try:
        return f"{float(text):.17g}"
    except ValueError:
        return text


def find_arm_problems(
    where: str, depth: str, sampled: Iterable[str], protocol: str, rig: str | None
) -> Iterable[Problem]:
    """Yield what is wrong with an arm once protocol and rig are known.

    That is several insertions in a run of which depth `world` computes one, and keys of whole numbers that are drawn
    between limits.

    Parameters
    ----------
    where : str
        Begins the place of each problem.
    sampled : iterable of str
        The dotted keys that are drawn.
    protocol, rig : str
        As JSON; the rig is None for an experiment that moves none.
    """
    document = {**json.loads(protocol), "rig": None if rig is None else json.loads(rig)}
    made = document.get("repetitions", 1)
    if depth == "world" and made > 1:
        yield Problem(
            f"{where} repetitions",
            f"a run of the protocol makes {made} insertions, and depth: world computes one for each task",
            "add set: {repetitions: 1}; the campaign's own repetitions say how often, or say depth: rig",
        )
    for key in sampled:
        if type(_find(document, key)) is int:
            yield Problem(
                f"{where} sample.keys.{key}",
                f"{key} takes whole numbers, and points are drawn between the limits",
                f"list its values: vary: {{{key}: [...]}}, a grid",
            )


def _find(document: object, key: str) -> object:
    """Return the value at a dotted key; None where there is none."""
    for part in key.split("."):
        if isinstance(document, Mapping):
            document = document.get(part)
        elif isinstance(document, list) and part.isdecimal() and int(part) < len(document):
            document = document[int(part)]
        else:
            return None
    return document
