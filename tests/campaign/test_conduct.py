"""A campaign goes on to its end, or a rule's, and keeps what is done whatever happens."""

from collections.abc import Generator, Iterable
from pathlib import Path

import pandas as pd
import pytest

from labrig.analysis.experiment import TaskOutcome
from labrig.campaign.inputs import LoadedCampaign
from labrig.campaign.run import compute_campaign, open_store
from labrig.campaign.tasks import CampaignTasks, TaskOrder
from labrig.errors import InputError, LabrigError
from tests.campaign.campaigns import Law, computing, load, write_campaign


class Told:
    """Remembers how far a campaign was, and stops it at a task."""

    def __init__(self, stop_at: int | None = None) -> None:
        self.done: list[int] = []
        self._stop_at = stop_at

    def __call__(self, done: int, of: int) -> None:
        """Take note."""
        assert done <= of
        self.done.append(done)
        if done == self._stop_at:
            raise KeyboardInterrupt


def conduct(loaded: LoadedCampaign, place: Path, law: Law, told: Told | None = None) -> tuple[int, bool]:
    """Conduct a campaign whose tasks follow a law; return how many are done, and whether a rule ended it."""
    with open_store(loaded, place) as store:
        compute_campaign(loaded, store, computing(law), told or Told())
        return store.done, store.ended_by_rule


def read(loaded: LoadedCampaign, place: Path) -> pd.DataFrame:
    """Return the table of a campaign."""
    with open_store(loaded, place) as store:
        return store.write_table()


def by_seed(order: TaskOrder) -> float:
    """Return a number that depends on the seed."""
    return order.seed % 1000 / 300.0


def test_the_table_has_a_row_for_each_task_with_its_values(tmp_path: Path) -> None:
    """Arm, point, repetition, seed, the varied keys, how it ended and its quantities."""
    loaded = load(write_campaign(tmp_path, vary={"policy.replan_every_mm": [5, 10]}, repetitions=3))
    assert conduct(loaded, tmp_path / "out", by_seed) == (6, False)
    table = read(loaded, tmp_path / "out")
    assert table["task"].tolist() == list(range(6))
    assert table["policy.replan_every_mm"].tolist() == [5.0, 10.0] * 3
    assert table["repetition"].tolist() == [0, 0, 1, 1, 2, 2]
    assert table["seed"].nunique() == 3
    assert table["true_target_error_mm"].tolist() == [seed % 1000 / 300.0 for seed in table["seed"]]


def test_one_that_was_interrupted_goes_on_to_the_same_table(tmp_path: Path) -> None:
    """What was done is not computed again."""
    loaded = load(write_campaign(tmp_path, vary={"policy.replan_every_mm": [5, 10]}, repetitions=10))
    conduct(loaded, tmp_path / "whole", by_seed)
    with pytest.raises(KeyboardInterrupt):
        conduct(loaded, tmp_path / "broken", by_seed, Told(stop_at=7))
    again = Told()
    conduct(loaded, tmp_path / "broken", by_seed, again)
    assert again.done[0] == 7
    pd.testing.assert_frame_equal(read(loaded, tmp_path / "broken"), read(loaded, tmp_path / "whole"))


def test_a_task_that_fails_is_a_row_with_its_error_and_the_rest_goes_on(tmp_path: Path) -> None:
    """It has no values."""
    loaded = load(write_campaign(tmp_path, repetitions=4))
    failing = {find_seed(loaded, 1)}
    conduct(loaded, tmp_path / "out", lambda order: float("inf") if order.seed in failing else 1.0)
    table = read(loaded, tmp_path / "out")
    assert table["error"].isna().tolist() == [True, False, True, True]
    assert table["true_target_error_mm"].isna().tolist() == [False, True, False, False]


def find_seed(loaded: LoadedCampaign, task: int) -> int:
    """Return the seed of a task."""
    return next(CampaignTasks(loaded).list_orders(task)).seed


def test_a_rule_ends_it_at_the_same_task_however_often_it_was_interrupted(tmp_path: Path) -> None:
    """And once it has ended, it computes no more."""
    rule = {"ci95_width_mm": 0.6, "at_most": 500}
    loaded = load(write_campaign(tmp_path, vary={"policy.replan_every_mm": [5, 10]}, stop_when=rule))
    whole = conduct(loaded, tmp_path / "whole", by_seed)
    assert whole[1]
    assert 60 < whole[0] < 1000
    for stop_at in (10, 59, 60, whole[0] - 1):
        with pytest.raises(KeyboardInterrupt):
            conduct(loaded, tmp_path / "broken", by_seed, Told(stop_at))
    assert conduct(loaded, tmp_path / "broken", by_seed) == whole

    def never(_: Iterable[TaskOrder]) -> Generator[TaskOutcome | LabrigError, None, None]:
        raise AssertionError("nothing is left to compute")

    with open_store(loaded, tmp_path / "broken") as store:
        compute_campaign(loaded, store, never, Told())
        assert store.ended_by_rule


def test_it_goes_on_with_more_repetitions_but_not_with_other_values(tmp_path: Path) -> None:
    """More rows, or another judgement, leave the rows that are there as they are."""
    conduct(load(write_campaign(tmp_path, repetitions=2)), tmp_path / "out", by_seed)
    more = load(write_campaign(tmp_path, repetitions=5, tolerance=1.0, title="More"))
    assert conduct(more, tmp_path / "out", by_seed) == (5, False)
    other = load(write_campaign(tmp_path, repetitions=5, set={"target.sd_mm": 1}))
    with pytest.raises(LabrigError, match="another campaign"):
        conduct(other, tmp_path / "out", by_seed)


def test_a_measure_that_no_task_has_is_refused_with_those_there_are(tmp_path: Path) -> None:
    """At the first task, or at the rows that are there; what is done stays done."""
    misspelt = load(write_campaign(tmp_path, repetitions=2, measure="true_target_eror_mm"))
    with pytest.raises(InputError, match="no number 'true_target_eror_mm'") as refused:
        conduct(misspelt, tmp_path / "out", by_seed)
    assert "did you mean true_target_error_mm? name one of: true_target_error_mm" in refused.value.hint
    assert len(read(misspelt, tmp_path / "out")) == 0
    sound = load(write_campaign(tmp_path, repetitions=2))
    conduct(sound, tmp_path / "out", by_seed)
    with pytest.raises(InputError, match="true_target_eror_mm"):
        conduct(misspelt, tmp_path / "out", by_seed)
    assert len(read(sound, tmp_path / "out")) == 2


def test_a_file_that_was_changed_is_refused_with_the_key_that_differs(tmp_path: Path) -> None:
    """Not with a checksum; what is done stays."""
    sound = load(write_campaign(tmp_path, vary={"policy.near_mm": [5, 10]}))
    conduct(sound, tmp_path / "out", by_seed)
    for keys, difference in (
        ({"vary": {"policy.near_mm": [5, 20]}}, r"policy\.near_mm\.1 is 10 there and 20 here"),
        ({"vary": {"policy.near_mm": [5, 10]}, "seed": 2}, "campaign.seed is 1 there and 2 here"),
    ):
        with pytest.raises(InputError, match=difference):
            conduct(load(write_campaign(tmp_path, **keys)), tmp_path / "out", by_seed)
    assert len(read(sound, tmp_path / "out")) == 2
