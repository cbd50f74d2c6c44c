"""CAN frames in words: which axis, which object, which value."""

from labrig.devices import epos2_objects as od
from labrig.devices.rig_file import RigDescription

_OBJECTS = {
    (entry.index, entry.subindex): entry for entry in vars(od).values() if isinstance(entry, od.Entry)
}
_POSITIONS = (od.TARGET_POSITION, od.LOWER_LIMIT, od.UPPER_LIMIT)


class CommandWords:
    """Says what a CAN frame means on a rig.

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
            return self._question(can_id - 0x600, data)
        if can_id == 0x080:
            return "SYNC"
        if can_id == 0 and len(data) == 2:
            return f"NMT command 0x{data[0]:02X} to node {data[1]}"
        return f"CAN frame {can_id:03X}#{data.hex().upper()}"

    def _question(self, node: int, data: bytes) -> str:
        name = self._axes[node][0] if node in self._axes else f"node {node}"
        index, subindex = int.from_bytes(data[1:3], "little"), data[3]
        entry = _OBJECTS.get((index, subindex))
        if entry is None:
            return f"{name}: object 0x{index:04X}:{subindex:02X} = {data[4:].hex()}"
        what = f"{name}: {entry.name} ({entry.place})"
        if data[0] == 0x40:
            return f"{what} is read"
        value = entry.unpack(data[4:])
        return f"{what} = {value}{self._in_units(node, entry, value)}"

    def _in_units(self, node: int, entry: od.Entry, value: int) -> str:
        if entry not in _POSITIONS or node not in self._axes:
            return ""
        axis = self._axes[node][1]
        return f" quadcounts, {axis.scale().to_position(value):.4f} {axis.unit}"
