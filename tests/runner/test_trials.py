"""Which trials of a run remain."""

from labrig.record.events import NO_DECISIONS, Repeat, Skip, fold_decisions
from labrig.runner.trials import Trial, list_remaining
from tests.runner.sessions import begun


def test_what_remains_follows_from_what_was_made_and_decided() -> None:
    """An interrupted trial, or one that a person had made again, comes next under a new number, and only once."""
    first = begun(0, None, "success")
    assert list_remaining("ab", [], NO_DECISIONS) == [Trial(0, "a"), Trial(1, "b")]
    assert list_remaining("ab", [first], NO_DECISIONS) == [Trial(1, "b")]
    assert list_remaining("ab", [begun(0, None, "failed")], NO_DECISIONS) == [Trial(1, "b")]
    broken = [first, begun(1, None, "interrupted")]
    assert list_remaining("ab", broken, NO_DECISIONS) == [Trial(2, "b", 1)]
    again = [*broken, begun(2, 1, "success")]
    assert list_remaining("ab", again, NO_DECISIONS) == []
    repeated = fold_decisions([Repeat(trial=2)])
    assert list_remaining("ab", again, repeated) == [Trial(3, "b", 2)]
    assert list_remaining("ab", again, repeated.add(Skip(trial=3, repeats=2))) == []
    assert list_remaining("ab", [], fold_decisions([Skip(trial=0)])) == [Trial(1, "b")]
