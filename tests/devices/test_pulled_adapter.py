"""An slcan adapter that is pulled in the middle of a move, over a real connection and in real time."""

from pathlib import Path

import pytest

from labrig.devices.simulated.slcan import SlcanAdapter
from labrig.errors import BusError
from tests.devices.bench_rig import bench_description, bench_rig
from tests.devices.served import Served, served_drives

HEARTBEAT_S, SPEED_MM_S, QUICK_STOP_MM_S2 = 3.0, 4.0, 50.0
PATIENT = ("can.answer_timeout_ms=5000", f"can.heartbeat.timeout_ms={1000 * HEARTBEAT_S:.0f}")


def _pull(served: Served) -> None:
    assert isinstance(served.bus, SlcanAdapter)
    served.do(served.bus.unplug)


def test_a_pulled_adapter_is_a_bus_error_and_the_drive_stops_by_itself(tmp_path: Path) -> None:
    """labrig names the bus; the drive misses the heartbeat and brakes, in its own time."""
    with served_drives("slcan") as served:
        description = bench_description(
            served.reached_by, *PATIENT, f"axes.insertion.quick_stop_deceleration={QUICK_STOP_MM_S2}"
        )
        drive = served.drives[1]
        with bench_rig(description, tmp_path) as rig:
            rig.reference_axes()
            rig.axis("insertion").start_move(119.0, SPEED_MM_S)
            _pull(served)
            with pytest.raises(BusError, match=r"the CAN (adapter is gone|bus took no frame)"):
                rig.wait(60.0)
            while drive.find_last("emergency") is None or drive.is_moving:
                rig.clock.sleep(0.01)
    emergency = drive.find_last("emergency")
    assert emergency is not None
    assert emergency.text == "0x8130"
    assert emergency.t_s <= drive.shaft.still_s <= emergency.t_s + SPEED_MM_S / QUICK_STOP_MM_S2 + 1e-6
