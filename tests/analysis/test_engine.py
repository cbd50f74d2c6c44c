"""Many tasks in worker processes: order, batches, failures, lost workers."""

import multiprocessing
import os
import signal
import sys
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import pytest
from threadpoolctl import threadpool_info

from labrig.analysis.engine import map_in_order, open_process_pool, run_in_order
from labrig.errors import AnswerIsNoError, BugError, LabrigError, MachineError


def square(task: int) -> int:
    """Return a result that tells its task."""
    return task * task


def fail(task: int) -> object:
    """Fail in every way that a task can."""
    match task:
        case 3:
            raise AnswerIsNoError("no answer", "try another")
        case 5:
            raise KeyError("missing")
        case 7:
            return lambda: task
        case 9:
            sys.exit(1)
        case 11:
            raise MemoryError
        case 13:
            os.kill(os.getpid(), signal.SIGKILL)
    return square(task)


def die_at_first(task: tuple[int, Path]) -> int:
    """Kill the worker of task 5, but only once."""
    number, marker = task
    if number == 5 and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return square(number)


def count_threads(task: int) -> int:
    """Return the most threads that a library of linear algebra uses here."""
    return max(int(info["num_threads"]) for info in threadpool_info())


@pytest.mark.parametrize("workers", [1, 3])
def test_results_are_in_the_order_of_the_tasks(workers: int) -> None:
    """Every task has its result, in order, whatever the number of workers."""
    with open_process_pool(workers, "squared") as pool:
        assert list(run_in_order(pool, square, range(100))) == [task * task for task in range(100)]


def test_tasks_are_drawn_as_they_are_needed() -> None:
    """Of endless tasks only a bounded number is drawn ahead, and what is ahead is dropped in the end."""
    drawn = 0

    def draw() -> Iterator[int]:
        nonlocal drawn
        while True:
            drawn += 1
            yield drawn

    with open_process_pool(2, "squared") as pool:
        results = run_in_order(pool, square, draw())
        assert list(islice(results, 20)) == [task * task for task in range(1, 21)]
        assert drawn <= 20 + 16 * 2
        results.close()
    assert multiprocessing.active_children() == []


def test_a_failed_task_is_a_value_and_the_others_go_on() -> None:
    """An error, a bug, a result that cannot be sent, a lack of memory and a death each cost their own task alone.

    A map raises the first error, after the results before it.
    """
    with open_process_pool(2, "failed") as pool:
        outcomes = list(run_in_order(pool, fail, range(20)))
    failed = {task: outcome for task, outcome in enumerate(outcomes) if isinstance(outcome, LabrigError)}
    expected = {3: AnswerIsNoError, 5: BugError, 7: BugError, 9: BugError, 11: MachineError, 13: MachineError}
    assert {task: type(error) for task, error in failed.items()} == expected
    assert (failed[3].message, failed[3].hint) == ("no answer", "try another")
    assert "KeyError: 'missing'" in failed[5].message
    assert "in fail\n" in failed[5].__notes__[0]
    assert failed[13].message == "a process that failed died of its task, 2 times or more"
    assert [outcomes[task] for task in range(20) if task not in failed] == [
        task * task for task in range(20) if task not in failed
    ]
    with open_process_pool(2, "failed") as pool:
        results = map_in_order(pool, fail, range(20))
        assert [next(results) for _ in range(3)] == [0, 1, 4]
        with pytest.raises(AnswerIsNoError, match="no answer"):
            next(results)


def test_a_worker_lost_once_costs_nothing_but_time(tmp_path: Path) -> None:
    """After SIGKILL to a worker its tasks are done again, and no result is missing."""
    tasks = [(number, tmp_path / "killed") for number in range(40)]
    with open_process_pool(2, "squared") as pool:
        outcomes = list(run_in_order(pool, die_at_first, tasks))
    assert (tmp_path / "killed").exists()
    assert outcomes == [number * number for number in range(40)]


def test_workers_compute_with_one_thread() -> None:
    """Linear algebra in a worker has one thread, so that its sums are rounded as on a computer with one core."""
    with open_process_pool(2, "counted threads") as pool:
        assert list(run_in_order(pool, count_threads, range(4))) == [1, 1, 1, 1]
