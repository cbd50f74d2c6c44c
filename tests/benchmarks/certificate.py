"""Whether what a certificate reports holds for other seeds: the share that arrives at each reported value."""

import tempfile
import time
from collections.abc import Generator, Iterable
from pathlib import Path

from labrig.analysis.certificate import Margin
from labrig.analysis.engine import open_process_pool, run_in_order
from labrig.analysis.outcome import TaskOutcome
from labrig.campaign.certificate import (
    RepeatOrder,
    certify,
    compute_repetition,
    make_certificate,
    make_inputs,
    prepare_repeat,
)
from labrig.campaign.statistics import bound_share
from labrig.devices.clocks import SystemClock
from labrig.errors import LabrigError
from labrig.posix import count_usable_cores
from labrig.runner.assumption import VirtualRepeat
from tests.benchmarks.table import print_rows
from tests.experiments.insertion.test_procedure import conduct_insertion, insertion

REPETITIONS = 30
FRESH_SEEDS = range(50_000, 50_200)
PAPER = ("target.position_mm=[0,4,100]", "insertion.max_length_mm=118")
OBSTACLES = "obstacles=[{position_mm: [0, 6, 34], radius_mm: 8}, {position_mm: [0, -7, 68], radius_mm: 8}]"


def print_table() -> None:
    """Print the margins of the example insertion, and how many of 200 other seeds arrive at each reported value."""
    with tempfile.TemporaryDirectory() as folder:
        _, run = conduct_insertion(Path(folder), insertion(*PAPER, OBSTACLES), ())
        repeat = prepare_repeat(run)
        with open_process_pool(count_usable_cores(), "computed tasks") as pool:

            def compute(
                orders: Iterable[RepeatOrder],
            ) -> Generator[TaskOutcome | LabrigError, None, None]:
                return run_in_order(pool, compute_repetition, orders, clock=SystemClock())

            began_s = time.perf_counter()
            found = certify(repeat, compute, lambda *_: None, repetitions=REPETITIONS)
            took_s = time.perf_counter() - began_s
            certificate = make_certificate(run, found, created=SystemClock().utc(), provenance={})
            print(
                f"{found.insertions} virtual insertions in {took_s:.0f} s; nothing wrong: {found.base.arrived} arrive"
            )
            rows = [
                _make_row(margin, list(compute(_list_fresh(repeat, margin))), repeat)
                for margin in certificate.margins
                if margin.misses_at is not None
            ]
    heads = (
        "assumption",
        "direction",
        "value",
        "margin",
        "in SDs",
        "arrive",
        "95 %",
        "of other seeds",
        "95 %",
    )
    print_rows(heads, rows)


def _list_fresh(repeat: VirtualRepeat, margin: Margin) -> list[RepeatOrder]:
    """Return a repetition with each fresh seed, at the reported value."""
    assert margin.misses_at is not None
    (turned,) = (assumption for assumption in repeat.assumptions if assumption.name == margin.name)
    inputs, settings = make_inputs(repeat), turned.settings(margin.misses_at.value)
    return [RepeatOrder(repeat.simulate, inputs, settings, seed) for seed in FRESH_SEEDS]


def _make_row(
    margin: Margin, outcomes: list[TaskOutcome | LabrigError], repeat: VirtualRepeat
) -> list[object]:
    assert margin.misses_at is not None
    there = margin.misses_at.arrivals
    arrived = sum(isinstance(outcome, TaskOutcome) and repeat.arrives(outcome) for outcome in outcomes)
    low, high = bound_share(arrived, len(outcomes)) or (0.0, 1.0)
    return [
        margin.name, f"{margin.direction:+d}", f"{margin.misses_at.value:.3g} {margin.unit}",
        "" if margin.margin is None else f"{margin.margin:.3g}",
        "" if margin.margin_sds is None else f"{margin.margin_sds:.1f}",
        f"{there.arrived} of {there.n}", f"{there.share_ci95[0]:.0%} to {there.share_ci95[1]:.0%}",
        f"{arrived} of {len(outcomes)}", f"{low:.0%} to {high:.0%}",
    ]  # fmt: skip
