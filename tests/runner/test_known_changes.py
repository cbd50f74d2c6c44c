"""The changes of labrig that explain why the replay of an older record differs."""

import math
import re
from collections.abc import Mapping
from typing import Any

import pytest

from labrig.devices.replayed.comparison import DifferingLines
from labrig.runner.known_changes import KNOWN_CHANGES, KnownChange, find_known_change
from tests.cli.conftest import ROOT

OLD: Mapping[str, Any] = {
    "protocol": {"target": {"tolerance_mm": 2.0}, "planner": {"method": "best"}},
    "rig": {"axes": {"insertion": {"unit": "mm"}}, "world": {"needle": {"diameter_mm": 1.2}}},
}
"""Protocol and rig of a record from before all changes."""
NEW: Mapping[str, Any] = {
    "protocol": {"target": {"sd_mm": 0.0}, "planner": {"staging": "staged"}},
    "rig": {"axes": {"insertion": {"driver": "epos2"}}, "world": {"needle": {"torsion_lag_deg": 0.0}}},
}

SEEN = "the needle's end is {} mm from the target in the plane, and between {} mm in space (95 %), and 2 mm are allowed"
DEEP = (
    "by its width and length in the picture the needle's end is {} mm behind the plane (standard deviation {} mm), "
    "which its path does not explain; " + SEEN
)
UNSURE = (
    SEEN + "; one camera does not see what is out of its plane, and most of the uncertainty comes from {}"
)
LAG = {"lag_rad": 0.0283, "lag_rad_per_mm": 0.0014, "sd_rad": 0.0298, "run": "earlier"}

# For each change: how its line of the changelog begins, an event of an older record, and what it has become.
KNOWN: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
    (
        "The interval of an insertion's error",
        {"kind": "trial_stop", "trial": 0, "cause": SEEN.format(0.21, "0.17 and 1.19")},
        {"kind": "trial_stop", "trial": 0, "cause": SEEN.format(0.21, "0.05 and 1.17")},
    ),
    (
        "A needle whose wandering",
        {"kind": "trial_stop", "outcome": "missed", "cause": DEEP.format(5.2, 1.0, 0.06, "3.42 and 7.27")},
        {
            "kind": "trial_stop",
            "outcome": "reached_in_plane_only",
            "cause": DEEP.format(4.8, 1.8, 0.06, "1.32 and 8.31"),
        },
    ),
    (
        "The place of the target was named too rarely",
        {
            "kind": "trial_stop",
            "outcome": "reached_in_plane_only",
            "cause": UNSURE.format(0.2, "0.1 and 2.4", "the place in the picture"),
        },
        {
            "kind": "trial_stop",
            "outcome": "reached_in_plane_only",
            "cause": UNSURE.format(0.2, "0.1 and 2.4", "the place of the target"),
        },
    ),
    (
        "What the error of a measured lag",
        {"kind": "trial_start", "trial": 0, "torsion": LAG},
        {"kind": "trial_start", "trial": 0, "torsion": LAG | {"error": {"best_mm": 49.8}}},
    ),
    (
        "The directions of the bevel's turns",
        {"kind": "flip", "trial": 0, "depth_mm": 18.6205, "from_rad": -0.007, "to_rad": -0.007 - math.pi},
        {"kind": "flip", "trial": 0, "depth_mm": 18.6205, "from_rad": -0.007, "to_rad": -0.007 + math.pi},
    ),
    (
        "The reason why there is no path",
        {
            "kind": "plan",
            "found": False,
            "refusal": "too long: the shortest path is 103.3 mm, and 99.5 mm are allowed",
        },
        {
            "kind": "plan",
            "found": False,
            "refusal": "no path found with up to 6 arcs and 99.5 mm: too long, the shortest found with up to 4 arcs "
            "and without obstacles has 103.3 mm",
        },
    ),
    (
        "Linear algebra rounds alike",
        {"kind": "roll_zero", "zero_rad": 0.010560372418963274, "deflection_mm": [-6.1, 5.9]},
        {"kind": "roll_zero", "zero_rad": 0.010560372418963272, "deflection_mm": [-6.1, 5.9]},
    ),
    ("An axis counts as standing", {"kind": "run_start", "t_s": 0.195}, {"kind": "run_start", "t_s": 0.495}),
]


def find(old: Mapping[str, Any], new: Mapping[str, Any], settings: Mapping[str, Any]) -> KnownChange | None:
    """Return the change that explains a difference of events."""
    return find_known_change(DifferingLines("event", old, new), settings)


def test_each_change_stands_in_the_changelog_word_for_word() -> None:
    """The sentences of each entry are in the section of the changelog that it names."""
    sections = {
        part.partition("\n")[0]: re.sub(r"\s+", " ", part)
        for part in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").split("\n## ")
    }
    assert len(KNOWN) == len(KNOWN_CHANGES)
    for change in KNOWN_CHANGES:
        assert change.changelog in sections[change.version]


@pytest.mark.parametrize(("begins", "old", "new"), KNOWN)
def test_a_difference_of_former_records_is_explained(
    begins: str, old: Mapping[str, Any], new: Mapping[str, Any]
) -> None:
    """Each difference names the line of the changelog that it comes from."""
    change = find(old, new, OLD)
    assert change is not None
    assert change.changelog.startswith(begins)


@pytest.mark.parametrize(("begins", "old", "new"), KNOWN)
def test_nothing_else_is_explained(begins: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> None:
    """The same difference in a record made since, beside another one, or in a state has no explanation."""
    if not begins.startswith("The place of the target"):
        assert find(old, new, NEW) is None
        assert find(old, new, {"protocol": {}, "rig": {}}) is None
    assert find({**old, "frame": 3}, {**new, "frame": 4}, OLD) is None
    assert find({**old, "kind": "observation"}, new, OLD) is None
    assert find_known_change(DifferingLines("state", old, new), OLD) is None
    assert find_known_change(None, OLD) is None


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (
            {"kind": "trial_stop", "cause": SEEN.format(0.21, "0.17 and 1.19")},
            {"kind": "trial_stop", "cause": SEEN.format(0.22, "0.05 and 1.17")},
        ),
        (
            {"kind": "trial_stop", "cause": "the needle was lost"},
            {"kind": "trial_stop", "cause": SEEN.format(0.21, "0.05 and 1.17")},
        ),
        (
            {"kind": "trial_stop", "cause": UNSURE.format(0.2, "0.1 and 2.4", "the place of the target")},
            {"kind": "trial_stop", "cause": UNSURE.format(0.2, "0.1 and 2.4", "the start")},
        ),
        (
            {"kind": "trial_start", "torsion": LAG},
            {"kind": "trial_start", "torsion": LAG | {"lag_rad": 0.03, "error": {}}},
        ),
        (
            {"kind": "plan", "refusal": "the start is blocked by obstacle 1"},
            {"kind": "plan", "refusal": "no path found with up to 6 arcs and 99.5 mm, obstacles or not"},
        ),
        ({"kind": "flip", "from_rad": 0.0, "to_rad": 3.1}, {"kind": "flip", "from_rad": 0.0, "to_rad": -3.1}),
        (
            {"kind": "flip", "to_rad": -math.pi, "overshoot_rad": -0.1},
            {"kind": "flip", "to_rad": math.pi, "overshoot_rad": 0.2},
        ),
        ({"kind": "roll_zero", "zero_rad": 0.0105603}, {"kind": "roll_zero", "zero_rad": 0.0105604}),
        ({"kind": "run_start", "t_s": 0.195}, {"kind": "run_start", "t_s": 0.505}),
    ],
)
def test_a_difference_that_only_looks_alike_is_not_explained(
    old: Mapping[str, Any], new: Mapping[str, Any]
) -> None:
    """Another place, lag, number or time than the change gives is a finding."""
    assert find(old, new, OLD) is None
