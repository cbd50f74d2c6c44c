"""The order in which a rig is watched, and what keeps its heartbeat from being sent."""

from collections.abc import Callable

import can
import pytest

from labrig.devices.simulated.bus import InProcessBus
from labrig.devices.simulated.node import NmtState
from labrig.devices.supervisor import Check, Supervisor
from labrig.errors import LabrigError, SafetyStopError
from tests.devices.beats import listening
from tests.devices.rigs import OpenedRig, opened_rig


def noted(name: str, done: list[str], *, needs_power: bool = True, fails: bool = False) -> Check:
    """Return a check that notes when it is looked at, and fails if it is told to."""

    def look() -> None:
        done.append(name)
        if fails:
            raise SafetyStopError(name)

    return Check(look, look, needs_power)


def test_checks_are_made_in_order_until_one_finds_something() -> None:
    """What comes after it is not looked at."""
    done: list[str] = []
    supervisor = Supervisor([noted("a", done), noted("b", done, fails=True), noted("c", done)])
    supervisor.has_power = True
    with pytest.raises(SafetyStopError, match="b"):
        supervisor.step()
    assert done == ["a", "b"]


def test_without_power_only_some_checks_are_made() -> None:
    """The others wait for it; getting ready for power asks each of them."""
    done: list[str] = []
    supervisor = Supervisor([noted("a", done), noted("b", done, needs_power=False)])
    supervisor.step()
    assert done == ["b"]
    supervisor.reset()
    assert done == ["b", "a", "b"]


def _command(opened: OpenedRig) -> None:
    master = InProcessBus(opened.hardware.wire, lambda _message: None)
    master.send(can.Message(arbitration_id=0x601, data=bytes(8), is_extended_id=False))


STRIKES: dict[str, Callable[[OpenedRig], object]] = {
    "the bus": lambda opened: opened.hardware.wire.enter_error_passive(),
    "a signal": lambda opened: setattr(opened.signal, "name", "SIGINT"),
    "another master": _command,
    "a drive": lambda opened: opened.drives["linear"].fail(0x4210),
    "an NMT state": lambda opened: setattr(opened.drives["linear"], "nmt_state", NmtState.PRE_OPERATIONAL),
}


@pytest.mark.parametrize("what", STRIKES)
def test_nothing_beats_before_a_finding_is_dealt_with(what: str) -> None:
    """A step that finds something sends no heartbeat, however long the last one is ago."""
    with opened_rig() as opened:
        opened.rig.connect()
        opened.rig.wait(0.3)
        STRIKES[what](opened)
        opened.hardware.clock.sleep(0.11)
        with listening(opened) as heard:
            with pytest.raises(LabrigError):
                opened.rig.supervise()
            assert heard.times_s == []
