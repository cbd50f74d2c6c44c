"""The torsion of a needle, measured on the simulated rig and kept with its roll zero."""

import math

import pytest

from labrig.devices.needle_state import RollZero
from labrig.errors import FileFormatError
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.roll_zero.result import RollZeroResult, describe_torsion
from labrig.experiments.shared.roll_zero_events import TorsionHole
from labrig.protocol.load import load_protocol
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.reader import Run
from labrig.steering.torsion import TorsionalLag
from labrig.steering.torsion_fit import TorsionFit
from tests.report.conftest import make_page
from tests.runner.sessions import PROTOCOLS, large_bench

LAG_DEG, PER_MM_DEG = 2.0, 0.1
DEPTHS_MM = (20.0, 40.0)
SHORT = (
    "roll_zero.length_mm=12", f"roll_zero.torsion.depths_mm={list(DEPTHS_MM)}",
    "roll_zero.torsion.max_sd_deg=10", "insertion.speed_mm_s=5",
)  # fmt: skip
TWISTED = (f"world.needle.torsion_lag_deg={LAG_DEG}", f"world.needle.torsion_lag_deg_per_mm={PER_MM_DEG}")


def roll_zero(*overrides: str) -> ExperimentProtocol:
    """Return a short search for the roll zero, with the torsion at two depths."""
    return load_protocol(PROTOCOLS / "roll-zero.yaml", PROTOCOL_MODELS, [*SHORT, *overrides])


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[RollZero, TorsionalLag, Run]:
    """What the rig's state keeps of a needle with a known lag, and the run that measured it."""
    protocol = roll_zero()
    with large_bench(tmp_path_factory.mktemp("torsion"), protocol, TWISTED) as opened:
        outcome, run = opened.conduct(protocol)
        assert (outcome.exit_status, outcome.error) == ("success", None)
        zero = opened.opened.rig.needle.recall_roll_zero("N1")
    assert zero is not None
    assert zero.torsion is not None
    return zero, zero.torsion, run


def test_the_lag_is_found_at_each_depth(measured: tuple[RollZero, TorsionalLag, Run]) -> None:
    """Turned to from both sides, in fresh gel, the lag is the world's within three SD, and does not shift the zero."""
    zero, torsion, run = measured
    holes = [(hole.hole, hole.depth_mm, hole.direction) for hole in run.read_events(TorsionHole)]
    assert holes == [(6, 20.0, 1), (7, 20.0, -1), (8, 40.0, 1), (9, 40.0, -1)]
    assert abs(zero.zero_rad) < 3 * zero.sd_rad
    for depth_mm in DEPTHS_MM:
        true_rad = math.radians(LAG_DEG + PER_MM_DEG * depth_mm)
        assert abs(torsion.at(depth_mm) - true_rad) < 3 * torsion.find_sd_rad(depth_mm)


def test_the_analysis_finds_the_same_lag_and_shows_it(measured: tuple[RollZero, TorsionalLag, Run]) -> None:
    """The result has the live run's lag; page, table and terminal show it with its standard deviation."""
    _, live, run = measured
    page = make_page(run)
    assert page.result is not None
    assert isinstance(page.result.content, RollZeroResult)
    torsion = page.result.content.torsion
    assert torsion is not None
    assert torsion.fit is not None
    assert torsion.fit.lag.lag_rad_per_mm == pytest.approx(live.lag_rad_per_mm, abs=1e-9)
    assert (page.result.path / "torsion.csv").read_text().count("\n") == 5
    assert "stays behind the rotation axis" in page.html
    assert f"SD {math.degrees(torsion.fit.sd_rad):.3f}" in page.html
    assert "<h3>Torsion</h3>" in page.html


def test_too_few_rolls_for_the_torsion_are_refused() -> None:
    """With five rolls a lag would shift the roll zero; the message names the key."""
    with pytest.raises(FileFormatError, match=r"roll_zero\.rolls") as refused:
        roll_zero("roll_zero.rolls=5")
    assert "torsion: null" in refused.value.problems[0].hint


@pytest.mark.parametrize(
    ("lag_deg", "per_mm_deg", "sentence"),
    [
        (0.10, 0.005, "No lag of its bevel was seen (below 1.3 degrees)"),
        (1.29, 0.005, "Its bevel stays behind the rotation axis by 1.290 degrees"),
        (0.10, 0.021, "Its bevel stays behind the rotation axis by 0.100 degrees"),
    ],
)
def test_a_lag_is_told_only_where_it_was_seen(lag_deg: float, per_mm_deg: float, sentence: str) -> None:
    """Below two of its standard deviations, 0.64 degrees and 0.01 for each mm here, there is a bound alone."""
    lag = TorsionalLag(
        math.radians(lag_deg), math.radians(per_mm_deg), 0.0, math.radians(0.64), math.radians(0.01)
    )
    fit = TorsionFit(lag, sd_rad=math.radians(0.64), radius_mm=27.7, residual_rms_mm=0.02)
    assert describe_torsion(fit).startswith(sentence)
