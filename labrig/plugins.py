"""What packages add to labrig: experiments, drives and cameras, found by their entry points.

labrig declares its own in the same way. Names come from the metadata of installed packages. A plugin is imported only
when it is used, so a package that cannot be imported stops no other command.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from importlib.metadata import Distribution, EntryPoint, entry_points

from labrig.errors import InputError, MachineError, PluginError

EXPERIMENTS = "labrig.experiments"
DRIVES = "labrig.drives"
CAMERAS = "labrig.cameras"

INTERFACE = 1
"""Version of the interfaces that plugins are written for; each states its own as `interface`."""

_NOUNS = {EXPERIMENTS: "experiment", DRIVES: "drive", CAMERAS: "camera"}


@dataclass(frozen=True)
class Plugin:
    """An entry point that a package declares.

    Attributes
    ----------
    group : str
        `EXPERIMENTS`, `DRIVES` or `CAMERAS`.
    name : str
        Protocols and rig files refer to it by this name.
    package, version : str
        The distribution that declares it.
    entry_point : EntryPoint
        Names the module and the object in it.
    """

    group: str
    name: str
    package: str
    version: str
    entry_point: EntryPoint

    def load(self) -> object:
        """Import the plugin and return the object that its entry point names.

        Raises
        ------
        PluginError
            When the import fails, or the plugin was written for another version of the interface.
        """
        try:
            found: object = self.entry_point.load()
        except Exception as error:
            raise PluginError(
                f"{self} cannot be imported: {type(error).__name__}: {error}",
                f"mend it, or install another version of {self.package}, or uninstall it",
            ) from error
        interface = getattr(found, "interface", None)
        if interface != INTERFACE:
            raise PluginError(
                f"{self} is written for interface {interface}, this labrig has interface {INTERFACE}",
                f"install a version of {self.package} that fits this labrig",
            )
        return found

    @property
    def title(self) -> str:
        """What it is: `drive epos2`."""
        return _title(self.group, self.name)

    @property
    def origin(self) -> str:
        """The package that declares it, with its version."""
        return f"{self.package} {self.version}"

    def __str__(self) -> str:
        """Name the plugin and the package that declares it."""
        return f"{self.title} of package {self.origin}"


def _title(group: str, name: str) -> str:
    return f"{_NOUNS[group]} {name}"


@cache
def find_plugins(group: str) -> Mapping[str, tuple[Plugin, ...]]:
    """Return the installed plugins of a group by name, sorted; a name that several packages claim has several.

    Raises
    ------
    MachineError
        When labrig's own are missing, as the installation is older than the code.
    """
    found: dict[str, tuple[Plugin, ...]] = {}
    for entry_point in sorted(entry_points(group=group), key=lambda point: (point.name, point.value)):
        name, (package, version) = entry_point.name, _read_package(entry_point.dist)
        plugin = Plugin(group, name, package, version, entry_point)
        found[name] = (*found.get(name, ()), plugin)
    if not any(plugin.package == "labrig" for plugins in found.values() for plugin in plugins):
        raise MachineError(
            f"labrig's own {_NOUNS[group]}s are not registered: the installation is older than the code",
            "install labrig again: pip install -e . in its folder",
        )
    return found


@cache  # a package with several plugins has its metadata parsed once
def _read_package(distribution: Distribution | None) -> tuple[str, str]:
    """Return name and version."""
    if distribution is None:
        return "unknown", ""
    metadata = distribution.metadata  # parsed at every access
    return metadata["Name"], metadata["Version"]


def find_plugin(group: str, name: str) -> Plugin:
    """Return the plugin of a group with this name; it has not been imported yet.

    Raises
    ------
    InputError
        When no installed package declares it, or when several do.
    MachineError
        When labrig's own are missing.
    """
    plugins = find_plugins(group)
    claimed = plugins.get(name, ())
    if len(claimed) == 1:
        return claimed[0]
    noun = _NOUNS[group]
    if claimed:
        packages = " and ".join(plugin.origin for plugin in claimed)
        raise InputError(
            f"{noun} {name} is claimed by {packages}; none of them is used", "uninstall all but one of them"
        )
    near = get_close_matches(name, plugins, 1)
    meant = f"did you mean {near[0]}? " if near else ""
    raise InputError(f"unknown {noun} {name!r}", f"{meant}installed are {', '.join(plugins)}")


def require_installed(group: str, name: str, run: str, made_with: Mapping[str, str]) -> None:
    """Refuse to compute with a run whose experiment, drive or camera no installed package has.

    Parameters
    ----------
    run : str
        The run, for the message.
    made_with : mapping of str to str
        What its record says of the packages that it was made with: title of a plugin -> origin.

    Raises
    ------
    InputError
        Names the package.
    """
    if name in find_plugins(group):
        return
    title = _title(group, name)
    package = made_with.get(title)
    origin = f" of package {package}" if package else ""
    raise InputError(
        f"{run} was made with the {title}{origin}, which is not installed",
        "install it; labrig runs, runs check, view and export do without it",
    )


def require_devices_installed(run: str, made_with: Mapping[str, str]) -> None:
    """Refuse to compute with a run, or replay it, whose drives or camera no installed package has.

    Raises as `require_installed`.
    """
    for group in (DRIVES, CAMERAS):
        start = _title(group, "")
        for title in made_with:
            if title.startswith(start):
                require_installed(group, title.removeprefix(start), run, made_with)
