"""The commissioning test of `labrig devices check --move`: does an axis stop by itself when labrig falls silent?"""

import pytest

from labrig.devices.check_result import CheckStatus
from labrig.devices.dead_man import try_dead_man
from labrig.devices.opening import Opening
from tests.devices.rigs import Person, opened_rig


@pytest.mark.parametrize(
    ("yes", "stops", "status", "told"),
    [
        (True, True, CheckStatus.PASS, "it stopped by itself, 0.5"),
        (True, False, CheckStatus.FAIL, "it moved on"),
        (False, True, CheckStatus.WARN, "not tried"),
    ],
)
def test_an_axis_has_to_stop_by_itself(*, yes: bool, stops: bool, status: CheckStatus, told: str) -> None:
    """Whatever its settings say; it is asked about before it moves, and the way that it still went is told."""
    with opened_rig(opening=Opening(("insertion",), camera=False)) as opened:
        opened.rig.operator = person = Person(yes)
        if not stops:
            vars(opened.drives["insertion"])["lose_master"] = lambda _t_s: None
        opened.rig.connect()
        result = try_dead_man(opened.rig, "insertion")
        assert result.status is status
        assert told in result.value
        assert "is going to move forwards by up to 2 mm, without a needle" in person.asked[0].text
        moved = opened.drives["insertion"].shaft_counts
        opened.hardware.clock.sleep(1.0)
        assert opened.drives["insertion"].shaft_counts == moved
        assert bool(moved) is yes
