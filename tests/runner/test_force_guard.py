"""Currents, inputs and stalls of a whole run: in its record, its tables and its replay."""

from pathlib import Path

import pytest

from labrig.errors import ForceGuardError
from labrig.experiments.registry import find_experiment
from labrig.record.agreement import Verdict
from labrig.report.tables import run_tables
from labrig.runner.replay import replay_run
from tests.runner.sessions import SHORT_WAY, Told, bench, sweep

SHORT = (*SHORT_WAY, "insertion.length_mm=5", "insertion.frame_every_mm=5")
INPUTS = (
    "axes.insertion.inputs={needle_force: {source: analog-1, unit: N, units_per_volt: 10}}",
    "axes.linear.inputs={door: {source: general-A, expected: true}}",
)


def test_every_state_line_has_currents_and_inputs(tmp_path: Path) -> None:
    """So have the tables of an export; the limits of the protocol hold; the replay is identical."""
    protocol = sweep(*SHORT, "max_current_ma={insertion: 700}")
    with bench(tmp_path, protocol, INPUTS) as opened:
        outcome, run = opened.conduct(protocol)
    assert outcome.error is None
    states = run_tables(run, None)["states"]
    assert {"insertion_current_ma", "rotation_current_ma", "linear_current_ma"} <= set(states)
    assert states["insertion_current_ma"].max() == -states["insertion_current_ma"].min() == pytest.approx(60)
    assert (states["input_needle_force_N"] == 0.0).all()
    assert states["input_door"].all()
    replayed = replay_run(run, find_experiment(protocol.experiment), protocol, Told())
    assert replayed.verdict is Verdict.IDENTICAL


def test_a_run_that_ended_in_a_stall_can_be_replayed(tmp_path: Path) -> None:
    """The replay meets the same stall at the same instant."""
    protocol = sweep(*SHORT)
    rig = (
        "axes.insertion.max_current_ma=800",
        "faults=[{fault: blocked, axis: insertion, at_s: 8, once: moving}]",
    )
    with bench(tmp_path, protocol, rig) as opened:
        outcome, run = opened.conduct(protocol)
    assert isinstance(outcome.error, ForceGuardError)
    assert outcome.reason.startswith("the insertion axis is stalled: 800 mA for ")
    assert run.states["insertion_current_ma"].iloc[-1] < 800
    replayed = replay_run(run, find_experiment(protocol.experiment), protocol, Told())
    assert replayed.verdict is Verdict.IDENTICAL
