"""CAN frames in words: which axis, which object, which value."""

from labrig.devices.axis_description import AxisDescription
from labrig.devices.drives.eds import count_bytes
from labrig.devices.drives.objects import LOWER_LIMIT, TARGET_POSITION, UPPER_LIMIT, Place
from labrig.devices.rig_file import RigDescription

_POSITIONS = (TARGET_POSITION, LOWER_LIMIT, UPPER_LIMIT)


class CommandFormatter:
    """Describes what a CAN frame means on a rig.

    Parameters
    ----------
    rig : RigDescription
        Gives the axes their nodes and units.
    """

    def __init__(self, rig: RigDescription) -> None:
        self._axes = {axis.node_id: (name, axis) for name, axis in rig.axes.items()}

    def __call__(self, can_id: int, data: bytes) -> str:
        """Return a frame as a phrase."""
        if 0x600 < can_id < 0x680:
            return self._describe_question(can_id - 0x600, data)
        if can_id == 0x080:
            return "SYNC"
        if can_id == 0 and len(data) == 2:
            return f"NMT command 0x{data[0]:02X} to node {data[1]}"
        return f"CAN frame {can_id:03X}#{data.hex().upper()}"

    def _describe_question(self, node: int, data: bytes) -> str:
        name, axis = self._axes.get(node, (f"node {node}", None))
        place = Place(int.from_bytes(data[1:3], "little"), data[3])
        found = None if axis is None else axis.find_object(*place)
        if axis is None or found is None:
            return f"{name}: object {place} = {data[4:].hex()}"
        what = f"{name}: {found.name} ({place})"
        if data[0] == 0x40:
            return f"{what} is read"
        value = int(found.decode_raw(data[4 : 4 + count_bytes(found)]))
        return f"{what} = {value}{_format_in_units(axis, place, value)}"


def _format_in_units(axis: AxisDescription, place: Place, value: int) -> str:
    if place not in _POSITIONS or axis.unknown:
        return ""
    return f" {axis.count_unit}, {axis.scale().to_position(value):.4f} {axis.unit}"
