"""Plugins that are installed and cannot be used: named by `check`, `devices check` and `schema`, fatal to nothing."""

from collections.abc import Iterator

from labrig.errors import InputError
from labrig.plugins import CAMERAS, EXPERIMENTS, find_plugins


def find_plugin_faults(*groups: str) -> Iterator[InputError]:
    """Yield what keeps each unusable plugin of these groups from being used.

    Raises
    ------
    MachineError
        When labrig's own plugins are missing.
    """
    for group in groups:
        for name in find_plugins(group):
            try:
                _find(group, name)
            except InputError as error:
                yield error


def _find(group: str, name: str) -> object:
    """Find a plugin of a group, and verify that it is of the right type."""
    from labrig.devices.axis_description import AxisDescription
    from labrig.devices.camera import CameraDescription
    from labrig.devices.driver_section import find_section
    from labrig.experiments.declared import find_experiment

    if group == EXPERIMENTS:
        return find_experiment(name)
    return find_section(group, name, CameraDescription if group == CAMERAS else AxisDescription)
