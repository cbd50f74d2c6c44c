"""Plugins that are installed and cannot be used: named by `check`, `devices check` and `schema`, fatal to nothing."""

from collections.abc import Callable, Iterator

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
        find = _finder(group)
        for name in find_plugins(group):
            try:
                find(name)
            except InputError as error:
                yield error


def _finder(group: str) -> Callable[[str], object]:
    """Return what finds a plugin of a group and verifies that it is of the right type."""
    if group == EXPERIMENTS:
        from labrig.experiments.declared import find_experiment

        return find_experiment
    if group == CAMERAS:
        from labrig.devices.camera import find_camera_kind

        return find_camera_kind
    from labrig.devices.drives.drive import find_drive_kind

    return find_drive_kind
