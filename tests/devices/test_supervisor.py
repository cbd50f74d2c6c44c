"""What keeps the heartbeat of a rig from being sent."""

from collections.abc import Callable

import can
import pytest

from labrig.devices.simulated.bus import InProcessBus
from labrig.devices.simulated.node import NmtState
from labrig.errors import LabrigError
from tests.devices.beats import listening
from tests.devices.rigs import OpenedRig, opened_rig
from tests.devices.wire_faults import ERROR_PASSIVE


def _command(opened: OpenedRig) -> None:
    master = InProcessBus(opened.hardware.wire, lambda _message: None)
    master.send(can.Message(arbitration_id=0x601, data=bytes(8), is_extended_id=False))


STRIKES: dict[str, Callable[[OpenedRig], object]] = {
    "the bus": lambda opened: opened.hardware.wire.report(*ERROR_PASSIVE),
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
