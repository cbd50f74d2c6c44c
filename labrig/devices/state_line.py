"""A reading of the axes as a line of states.jsonl, and back."""

from collections.abc import Mapping
from typing import Any

from labrig.devices.drives.drive import DriveReading
from labrig.devices.rig_file import RigDescription


def write_state_line(rig: RigDescription, states: Mapping[str, DriveReading]) -> dict[str, object]:
    """Return the fields of a line but its time, by axis.

    They are the positions [mm or rad], the statuswords, whether the last move is done, the motor currents [mA], and
    the inputs by their names.
    """
    axes = dict(rig.axes.items())
    fields: dict[str, object] = {
        f"{name}_{axes[name].unit}": state.position for name, state in states.items()
    }
    fields |= {f"{name}_statusword": state.statusword for name, state in states.items()}
    fields |= {f"{name}_arrived": state.target_reached for name, state in states.items()}
    fields |= {f"{name}_current_ma": state.current_ma for name, state in states.items()}
    for name, state in states.items():
        channels = axes[name].inputs
        fields |= {channels[channel].column(channel): value for channel, value in state.inputs.items()}
    return fields


def read_state_line(rig: RigDescription, line: Mapping[str, Any]) -> dict[str, DriveReading]:
    """Return the reading of a line. Raises `KeyError` where a value is missing."""
    states = {}
    for name, axis in rig.axes.items():
        columns = {channel: axis.inputs[channel].column(channel) for channel in axis.inputs}
        states[name] = DriveReading(
            position=float(line[f"{name}_{axis.unit}"]),
            statusword=int(line[f"{name}_statusword"]),
            target_reached=bool(line[f"{name}_arrived"]),
            current_ma=line[f"{name}_current_ma"],
            inputs={channel: line[column] for channel, column in columns.items() if column in line},
        )
    return states
