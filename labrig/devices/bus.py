"""The CAN bus, real or inside the process, as one `CanLink`; whoever has a link cannot tell which."""

import logging
from dataclasses import dataclass

import can
import canopen

from labrig.devices.rig_file import CanDescription
from labrig.errors import BusError

RESPONSE_TIMEOUT_S = 0.3
"""How long a drive on a real bus may take to answer; a real EPOS2 took at most 13 ms in 30 000 answers."""

_NOTIFIER_CYCLE_S = 0.1
"""How long closing may wait for python-can's thread."""

_OPENING_FAILURES = (can.CanError, OSError, ValueError, ImportError, NameError, TypeError, AttributeError)
"""Interfaces of python-can whose vendor's driver is missing fail in each of these ways."""

# What these libraries log comes back as errors of ours; without a handler Python would print it to stderr as
# well.
for _library in ("canopen", "can"):
    logging.getLogger(_library).addHandler(logging.NullHandler())


@dataclass(frozen=True)
class CanLink:
    """A connected bus.

    Parameters
    ----------
    network : canopen.Network
        The bus as `canopen` has it.
    response_timeout_s : float
        How long a node may take to answer, in the computer's time. On a bus inside the process an answer is
        there as soon as the question has been sent, or never comes.
    """

    network: canopen.Network
    response_timeout_s: float

    def send(self, can_id: int, data: bytes) -> None:
        """Send one frame.

        Raises
        ------
        BusError
        """
        try:
            self.network.send_message(can_id, data)
        except (can.CanError, OSError) as error:
            raise BusError(
                f"the CAN bus took no frame: {error}", "check adapter, cable, power and bit rate"
            ) from error

    def close(self) -> None:
        """Leave the bus."""
        try:
            self.network.disconnect()
        except (can.CanError, OSError) as error:
            raise BusError(
                f"the CAN bus did not close: {error}", "unplug the adapter and plug it in again"
            ) from error


def open_can(description: CanDescription) -> CanLink:
    """Connect to a real CAN interface through python-can.

    Raises
    ------
    BusError
        When the interface is unknown, its driver is missing, or it cannot be reached.
    """
    network = canopen.Network()
    network.NOTIFIER_CYCLE = _NOTIFIER_CYCLE_S
    where = f"{description.interface} {description.channel}".strip()
    try:
        network.connect(
            interface=description.interface, channel=description.channel or None, bitrate=description.bitrate
        )
    except _OPENING_FAILURES as error:
        raise BusError(f"CAN interface {where} cannot be opened: {error}", _hint(description)) from error
    return CanLink(network, RESPONSE_TIMEOUT_S)


def _hint(description: CanDescription) -> str:
    if description.interface == "socketcan":
        channel = description.channel or "can0"
        return (
            f"plug in the adapter, then as root: ip link set {channel} up type can bitrate "
            f"{description.bitrate}; ip link shows which interfaces there are"
        )
    known = ", ".join(sorted(can.VALID_INTERFACES))
    return (
        f"check can.interface and can.channel in the rig file, adapter and driver; python-can knows {known}"
    )
