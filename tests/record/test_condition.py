"""The language of `labrig runs --where`."""

from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.errors import InputError
from labrig.record.condition import parse_condition
from labrig.record.run_index import RunIndex, ask_index

FIELDS: dict[str, Any] = {
    "exit_status": ["success"],
    "operator": ["Chen Yang"],
    "started": ["2026-03-02T09:30:00+00:00"],
    "seed": [7],
    "provenance.git_dirty": [False],
    "reason": [None],
    "protocol.specimens.gelatin_percent": [10.0, 13.0],
    "protocol.needle.diameter_mm": [1.2],
    "result.mean_radius_mm": [27.6],
    "result.specimens.mean_radius_mm": [27.0, 28.2],
}


def fits(text: str) -> bool:
    """Return whether a run with these fields fits; its index is in memory, as the folder does not exist."""
    condition = parse_condition(text)

    def ask(index: RunIndex) -> bool:
        index.summaries({"run": ""}, lambda name: {"name": name})
        index.refresh_leaves({"run": "1"}, lambda _: FIELDS)
        return "run" in index.find([name for name, _ in condition.names], condition)

    return ask_index(Path("no folder"), ask)


@pytest.mark.parametrize(
    ("text", "holds"),
    [
        ("gelatin_percent=13 and exit_status=success", True),
        ("gelatin_percent=16", False),
        ("gelatin_percent=10 and gelatin_percent=13", True),
        ("gelatin_percent!=13", False),
        ("gelatin_percent!=16", True),
        ("seed<=7 and not seed<7", True),
        ("seed = 7.0", True),
        ("exit_status=failed or (seed>6 and seed<8)", True),
        ("exit_status=failed or seed>6 and seed>8", False),
        ("operator='Chen Yang'", True),
        ('operator ~ "yang"', True),
        ("started>=2026-03-01 and started<2026-03-03", True),
        ("git_dirty=false", True),
        ("reason=null", True),
        ("reason<1", False),
        ("mean_radius_mm>28", False),  # the result's own, not that of a specimen in it
        ("specimens.mean_radius_mm>28", True),
        ("protocol.needle.diameter_mm=1.2", True),
        ("seed>apple", False),
        ("missing!=1", False),
        ("operator ~ YANG and not reason ~ YANG", True),
        ("seed='7' and seed!='7.0'", True),
        ("seed>apple or reason>apple", False),
        ("started>2025", True),
        (" or ".join(f"seed={number}" for number in range(900)), True),
        ("operator='\udc80'", False),
    ],
)
def test_a_condition_holds_or_not(text: str, holds: bool) -> None:
    """Comparisons are of numbers or text; of several values one is enough; and binds before or."""
    assert fits(text) is holds


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "character 1: expected the name of a field, found the end"),
        ("seed 7", "character 6: expected one of"),
        ("seed=", "character 6: expected a value"),
        ("seed=7 exit_status=success", "character 8: expected and, or, or the end"),
        ("(seed=7", "character 8: expected a closing bracket"),
        ("operator='Chen", "character 10: this cannot be read; is a quote open"),
        ("not " * 200 + "seed=7", "more than 50 levels"),
        (" or ".join(["seed=7"] * 1001), "more than 1000 comparisons"),
        ("and=7", "character 1: expected the name of a field"),
    ],
)
def test_what_cannot_be_read_is_refused_with_its_place(text: str, words: str) -> None:
    """The message says at which character the condition stops making sense, and what belongs there."""
    with pytest.raises(InputError, match=words.replace("(", r"\(")):
        parse_condition(text)


def test_a_field_that_no_run_has_is_refused_with_those_that_there_are() -> None:
    """A misspelt field is named with its place and the one that was probably meant; nonsense means none."""
    with pytest.raises(InputError, match="character 12: no run has a field 'gelatine_percent'") as refusal:
        parse_condition("seed=7 and gelatine_percent=13").require_known(FIELDS)
    assert refusal.value.hint.startswith("did you mean gelatin_percent? fields: exit_status, started")
    with pytest.raises(InputError) as refusal:
        parse_condition("nonsense=1").require_known({*FIELDS, "notes"})
    assert refusal.value.hint.startswith("fields: exit_status")


@given(st.text(alphabet="abc=<>!~()'\" 17andor;-", max_size=40))
def test_any_text_is_read_or_refused(text: str) -> None:
    """Nothing that is typed leaves the parser by another way than an answer or a named refusal."""
    with suppress(InputError):
        assert fits(text) in {True, False}
