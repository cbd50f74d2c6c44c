"""The bus of an interface that delivers what is sent to its sender too."""

from labrig.devices.bus import BusNetwork
from labrig.devices.clocks import SimulatedClock
from labrig.devices.simulated.bus import InProcessBus, InProcessWire

FRAME = (0x601, b"\x40\x41\x60\0\0\0\0\0")


def test_a_lost_echo_hides_the_same_frame_of_another_program_only_for_a_moment() -> None:
    """An echo that comes goes to nobody; one that never came is not waited for."""
    clock, heard = SimulatedClock(), []
    network = BusNetwork(clock, echoes=True)
    network.bus = InProcessBus(InProcessWire(), lambda _message: None)
    network.subscribe(FRAME[0], lambda _can_id, data, _timestamp: heard.append(bytes(data)))
    network.send_message(*FRAME)
    network.notify(FRAME[0], bytearray(FRAME[1]), 0.0)
    assert heard == []
    network.notify(FRAME[0], bytearray(FRAME[1]), 0.0)
    assert heard == [FRAME[1]]
    network.send_message(*FRAME)
    clock.sleep(0.2)
    network.notify(FRAME[0], bytearray(FRAME[1]), 0.0)
    assert heard == [FRAME[1]] * 2
