"""Plugins that are installed and cannot be used: `check` and `devices check` name them, and nothing fails for them."""

from labrig.devices.axis_description import AxisDescription
from labrig.devices.camera import CameraDescription
from labrig.devices.driver_section import find_section
from labrig.errors import InputError
from labrig.experiments.declared import find_experiment
from labrig.plugins import CAMERAS, EXPERIMENTS, find_plugins


def find_plugin_faults(*groups: str) -> list[InputError]:
    """Return what keeps each unusable plugin of these groups from being used.

    Raises
    ------
    MachineError
        When labrig's own plugins are missing.
    """
    faults = []
    for group in groups:
        for name in find_plugins(group):
            try:
                if group == EXPERIMENTS:
                    find_experiment(name)
                else:
                    find_section(group, name, CameraDescription if group == CAMERAS else AxisDescription)
            except InputError as error:
                faults.append(error)
    return faults
