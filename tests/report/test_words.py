"""Numbers, lists and events as text."""

import pytest

from labrig.report.event_words import describe_event
from labrig.report.formatting import flatten, format_time, format_value, interval, label_key, number, signed


@pytest.mark.parametrize(
    ("made", "texts"),
    [
        ((number(27.6), number(-0.5, 1), number(None)), ("27.60", "−0.5", "–")),
        ((signed(0.0123), signed(-0.0001), signed(None)), ("+0.012", "0.000", "–")),
        ((interval((1.0, 2.5)), interval(None)), ("1.00 to 2.50", "–")),
        ((label_key("speed_mm_s"),), ("speed (mm/s)",)),
        ((label_key("s.true_target_error_mm"),), ("s true error at the target (mm)",)),
        ((format_time("2026-11-21T09:30:00+00:00"),), ("2026-11-21 09:30:00 UTC",)),
        ((format_value(-0.123456789), format_value(None), format_value(3)), ("−0.123457", "–", "3")),
    ],
)
def test_values_read_as_text(made: tuple[str, ...], texts: tuple[str, ...]) -> None:
    """Decimals stay aligned, a minus is a minus, what is unknown is a dash, and there is no negative zero."""
    assert made == texts


def test_nested_documents_become_rows() -> None:
    """Keys are joined by dots, lists of numbers stay in one row, lists of sections are numbered."""
    document = {"a": {"b": 1.5, "c": [1, 2]}, "d": [{"e": True}, {"e": None}], "f": ""}
    rows = [("a.b", "1.5"), ("a.c", "1, 2"), ("d[0].e", "yes"), ("d[1].e", "–"), ("f", "–")]
    assert flatten(document) == rows


REFUSED = {"specimen": "A1", "hole": 2, "position_mm": 16.0}
TURNS = "rotation moves to 180.0° at 57.3°/s"
TOLD = "operator: refused “shift to hole (specimen A1, hole 3, position 16 mm)”"


@pytest.mark.parametrize(
    ("kind", "fields", "text", "level"),
    [
        ("run_stop", {"exit_status": "success", "reason": ""}, "run succeeded", "INFO"),
        ("run_stop", {"exit_status": "failed", "reason": "drive 2"}, "run failed: drive 2", "ERROR"),
        ("move", {"axis": "rotation", "position": 3.14159, "speed": 1.0}, TURNS, "DEBUG"),
        ("operator", {"request": "ShiftToHole", "confirmed": False, "answer": "", "details": REFUSED}, TOLD, "WARN"),
        ("skip", {"t_s": 1.0, "trial": 3}, "Trial 4 was skipped.", "WARN"),
        ("odd_one", {"t_s": 1.0, "depth_mm": 1.25, "done": True}, "odd one: depth 1.25 mm, done yes", "INFO"),
        ("odd_one", {"heading_rad": -0.0012632}, "odd one: heading −0.07238 degrees", "INFO"),
        ("move", {"axis": "linear", "note": "odd line"}, "move: axis linear, note odd line", "DEBUG"),
        ("flip", {"by": 2}, "bevel turns 2", "INFO"),
    ],
)  # fmt: skip
def test_an_event_is_a_sentence(kind: str, fields: dict[str, object], text: str, level: str) -> None:
    """Known kinds have words, an experiment's own too, others their fields with units; what went wrong stands out."""
    entry = describe_event({"kind": kind, **fields}, {"flip": "bevel turns {{ by }}"})
    assert (entry.text, entry.level) == (text, level)
