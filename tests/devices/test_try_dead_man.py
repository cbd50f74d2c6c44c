"""The commissioning test of `labrig devices check --move`: does an axis stop by itself when labrig falls silent?"""

from labrig.devices.can_description import HeartbeatDescription
from labrig.devices.check_result import CheckStatus
from labrig.devices.dead_man import _Trial, try_dead_man
from labrig.devices.heartbeat import HeartbeatClock
from tests.devices.rigs import one_drive, simulated_rig


def test_every_axis_that_stops_by_itself_passes() -> None:
    """Each is asked about before it moves, and the way that it still went is told."""
    asked: list[str] = []

    def confirm(what: str) -> bool:
        asked.append(what)
        return True

    results = list(try_dead_man(simulated_rig(), confirm))
    assert [result.status for result in results] == [CheckStatus.PASS] * 3, results
    assert "it stopped by itself, 0.5" in results[0].value
    assert "Axis insertion moves forwards by up to 2 mm, without a needle" in asked[0]


def test_an_axis_that_nobody_confirms_does_not_move() -> None:
    """It is not tried, and the result says so."""
    results = list(try_dead_man(simulated_rig(), lambda _what: False))
    assert {result.value for result in results} == {"not tried"}


def test_an_axis_that_moves_on_fails() -> None:
    """Its settings were read back, and it does not do what they say."""
    with one_drive() as one:
        vars(one.drive)["lose_master"] = lambda _t_s: None
        section, link, heartbeat = one.driver.section, one.driver._link, HeartbeatDescription()
        trial = _Trial(section, HeartbeatClock(one.clock, link, heartbeat), heartbeat)
        goes_on, _ = trial.make(section.open(link, "insertion", trial.beating), one.clock)
        assert goes_on
        assert not one.drive.is_powered()
