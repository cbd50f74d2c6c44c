"""Events as sentences."""

import pytest

from labrig.report.event_words import describe_event


@pytest.mark.parametrize(
    ("event", "text", "level"),
    [
        ({"kind": "run_stop", "exit_status": "success", "reason": ""}, "run succeeded", "INFO"),
        ({"kind": "run_stop", "exit_status": "failed", "reason": "drive 2"}, "run failed: drive 2", "ERROR"),
        (
            {"kind": "move", "axis": "rotation", "position": 3.141592653589793, "speed": 1.0},
            "rotation moves to 180.0° at 57.3°/s",
            "DEBUG",
        ),
        (
            {
                "kind": "operator",
                "request": "ShiftToHole",
                "details": {"specimen": "A1", "hole": 2, "position_mm": 16.0},
                "confirmed": False,
                "answer": "",
            },
            "operator: refused “shift to hole (specimen A1, hole 3, position 16 mm)”",
            "WARN",
        ),
        ({"kind": "skip", "t_s": 1.0, "trial": 3}, "Trial 4 was skipped.", "WARN"),
        ({"kind": "odd_one", "t_s": 1.0, "depth_mm": 1.25, "done": True}, "odd one: depth 1.25 mm, done yes", "INFO"),
        ({"kind": "move", "axis": "linear", "note": "old line"}, "move: axis linear, note old line", "DEBUG"),
    ],
)  # fmt: skip
def test_an_event_is_a_sentence(event: dict[str, object], text: str, level: str) -> None:
    """Known kinds have words, others their fields with units, and what went wrong stands out."""
    entry = describe_event(event, {})
    assert (entry.text, entry.level) == (text, level)


def test_an_experiment_has_words_of_its_own() -> None:
    """A sentence of an experiment takes precedence."""
    assert describe_event({"kind": "flip", "by": 2}, {"flip": "bevel turns {{ by }}"}).text == "bevel turns 2"
