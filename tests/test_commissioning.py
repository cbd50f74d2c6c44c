"""Commissioning a bare rig: refusing unsafe motions, and asking before each motion."""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import partial

import pytest

from labrig.devices.opening import Opening
from labrig.devices.operator import ConfirmFaultReset, ConfirmHere
from labrig.devices.rig import Rig
from labrig.devices.rig_file import RigDescription
from labrig.errors import DriveError, DriveFaultError, InputError, LimitError, SafetyStopError
from labrig.library.commissioning import home_axes, jog
from tests.devices import epos2_places as od
from tests.devices.rigs import OpenedRig, Person, Signal, opened_rig, simulated_rig
from tests.runner.sessions import Watched


@contextmanager
def _bare(description: RigDescription | None = None) -> Iterator[tuple[OpenedRig, Watched]]:
    with opened_rig(description) as opened:
        opened.rig.connect()
        watched = opened.rig.operator = Watched(opened.rig.operator)
        yield opened, watched


def test_axes_are_homed_in_their_order_on_confirmation() -> None:
    """Axes are homed in order, the linear module first; without a search nothing moves, and each zero is confirmed."""
    with _bare() as (opened, watched):
        home_axes(opened.rig, None, needle_mounted=True)
        asked = [request for request in watched.asked if isinstance(request, ConfirmHere)]
        assert [request.axis for request in asked] == ["linear", "insertion", "rotation"]
        assert opened.rig.state.referenced == ("insertion", "rotation", "linear")
        assert all(drive.shaft_counts == 0 for drive in opened.drives.values())


@pytest.mark.parametrize("method", [-1, -2, -3, -4, 17, 18])
def test_a_bare_axis_searches_its_reference(method: int) -> None:
    """An axis searches its stop or switch in the direction of its method, and is referenced there."""
    switches = "axes.linear.limit_switches=[]"
    description = simulated_rig(f"axes.linear.homing={{method: {method}, speed: 5, position: 2}}", switches)
    with _bare(description) as (opened, _):
        opened.rig.home_axis("linear", method, needle_mounted=False)
        shaft = opened.drives["linear"].shaft_counts
        assert shaft > 0 if method in {-1, -3, 18} else shaft < 0
        assert abs(opened.rig.read_states()["linear"].position - 2) < 0.02 or method in {-1, -2}
        assert "linear" in opened.rig.state.referenced


@pytest.mark.parametrize(
    ("axis", "method", "mounted", "words"),
    [
        ("insertion", -4, True, "could bend"), ("rotation", 17, True, "could bend"),
        ("linear", -3, True, "towards the gel"), ("insertion", -4, False, "before the linear module"),
    ],
)  # fmt: skip
def test_a_search_that_could_do_harm_is_refused(axis: str, method: int, mounted: bool, words: str) -> None:
    """A search with a mounted needle or out of order is refused, with the command to use instead."""
    with _bare() as (opened, _):
        with pytest.raises(SafetyStopError, match=words) as refusal:
            opened.rig.home_axis(axis, method, needle_mounted=mounted)
        assert refusal.value.hint
        assert all(not drive.is_moving for drive in opened.drives.values())


def test_a_stop_that_could_not_be_felt_or_found_gives_no_reference() -> None:
    """A current limit below the threshold would push forever; a search that finds nothing in time halts the axis."""
    with _bare(simulated_rig("axes.linear.homing={method: -4, speed: 0.1, timeout_s: 2}")) as (opened, _):
        with pytest.raises(DriveError, match="did not find home in time"):
            opened.rig.home_axis("linear", -4, needle_mounted=False)
        assert not opened.drives["linear"].is_moving
        assert opened.rig.state.referenced == ()
        opened.rig._opening = Opening(max_current_ma={"linear": 400})
        with pytest.raises(LimitError, match="felt at 500 mA, and no drive exceeds 400 mA"):
            opened.rig.home_axis("linear", -4, needle_mounted=False)


def test_nothing_is_homed_or_jogged_with_a_needle_in_tissue() -> None:
    """With a needle in tissue homing and jogging are refused, with the command that withdraws it."""
    with _bare() as (opened, _):
        opened.rig.needle.mark_in_tissue("run-7")
        for action in (
            partial(home_axes, opened.rig, 35, needle_mounted=True),
            partial(jog, opened.rig, "insertion", 1.0),
        ):
            with pytest.raises(SafetyStopError, match="run-7") as refusal:
                action()
            assert "labrig devices withdraw" in refusal.value.hint


def test_a_jog_is_slow_short_and_within_limits() -> None:
    """A jog that is too long, too fast or beyond a limit is refused before anything moves."""
    with _bare() as (opened, _):
        with pytest.raises(InputError, match="too far for an axis without a reference"):
            jog(opened.rig, "insertion", 25.0)
        with pytest.raises(InputError, match="not within 0 to 5 mm/s"):
            jog(opened.rig, "insertion", 1.0, 8.0)
        opened.rig.home_axis("insertion", 35, needle_mounted=True)
        with pytest.raises(LimitError):
            jog(opened.rig, "insertion", -5.0)
        assert opened.drives["insertion"].shaft_counts == 0


def test_one_axis_is_commissioned_while_the_others_are_unknown() -> None:
    """An axis can be commissioned, at low current, while the entries of the others are missing."""
    with opened_rig() as opened:
        opening = Opening(("linear",), camera=False, max_current_ma={"linear": 300})
        rig = Rig(
            opened.rig.description, hardware=opened.hardware, link=opened.hardware.open_link(), source=None,
            person=Person(), interrupted=Signal(), opening=opening,
        )  # fmt: skip
        rig.connect()
        drive = opened.drives["linear"]
        assert drive.objects.values[od.CURRENT_LIMIT] == 300
        jog(rig, "linear", 1.0)
        with pytest.raises(InputError, match="axis insertion is not open"):
            rig.axis("insertion")
        rig.close()
        assert drive.objects.values[od.CURRENT_LIMIT] == 25_000


@pytest.mark.parametrize("yes", [False, True])
def test_a_fault_is_reset_only_on_confirmation(yes: bool) -> None:
    """It is shown with its remedy."""
    with opened_rig() as opened:
        opened.drives["insertion"].cut_power_stage()
        opened.drives["insertion"].restore_power_stage()
        opened.rig._opening = Opening(reset_faults=True)
        declines = None if yes else ConfirmFaultReset
        watched = opened.rig.operator = Watched(opened.rig.operator, declines=declines)
        with nullcontext() if yes else pytest.raises(DriveFaultError, match="did not confirm"):
            opened.rig.connect()
        asked = watched.asked[0]
        assert isinstance(asked, ConfirmFaultReset)
        assert "0x3220" in asked.fault


def test_a_fault_whose_cause_lasts_is_not_reset_and_a_run_resets_none() -> None:
    """If the supply is still cut, connecting fails with that reason."""
    with opened_rig() as opened:
        opened.drives["insertion"].cut_power_stage()
        opened.rig._opening = Opening(reset_faults=True)
        with pytest.raises(DriveFaultError, match="its cause is still there"):
            opened.rig.connect()
    with opened_rig() as opened:
        opened.drives["insertion"].fail(0x8130)
        with pytest.raises(DriveFaultError, match="0x8130") as fault:
            opened.rig.connect()
        assert "labrig devices home --axis insertion" in fault.value.hint
