"""What packages add to labrig, found by their entry points."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from labrig.devices.axis_description import AxisDescription
from labrig.devices.driver_section import find_section
from labrig.errors import InputError, LabrigError, MachineError, PluginError
from labrig.plugins import CAMERAS, DRIVES, find_plugin, find_plugins
from tests.installing import install_package

KIND = "class KIND:\n    interface = {}\n"


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Yield a folder of installed packages, two of which claim one name."""
    monkeypatch.syspath_prepend(str(tmp_path))
    install_package(tmp_path, "labrig", "[labrig.drives]\nepos2 = labrig.devices.drives.epos2:DRIVE\n")
    drives = {"sound": KIND.format(1), "newer": KIND.format(2), "broken": "1 / 0\n"}
    for name, code in drives.items():
        declared = f"[labrig.drives]\n{name} = lab_{name}_drive:KIND\n"
        install_package(tmp_path, f"lab-{name}", declared, f"lab_{name}_drive", code)
    for package in ("lab-one", "lab-two"):
        install_package(tmp_path, package, "[labrig.drives]\nclaimed = lab_one:DRIVE\n")
    yield tmp_path
    find_plugins.cache_clear()


def test_a_package_adds_a_drive_by_declaring_it(site: Path) -> None:
    """It is found by its name, with package and version, and is loaded when it is asked for."""
    plugin = find_plugin(DRIVES, "sound")
    assert (plugin.package, plugin.version) == ("lab-sound", "1.5")
    assert getattr(plugin.load(), "interface", None) == 1


@pytest.mark.parametrize(
    ("find", "error", "words"),
    [
        (lambda: find_plugin(DRIVES, "soundd"), InputError, "unknown drive 'soundd'.*did you mean sound?.*epos2"),
        (lambda: find_plugin(DRIVES, "claimed"), InputError, r"lab-one 1\.5 and lab-two 1\.5"),
        (lambda: find_plugin(DRIVES, "broken").load(), PluginError, r"broken of package lab-broken 1\.5.*ZeroDivision"),
        (lambda: find_plugin(DRIVES, "newer").load(), PluginError, "for interface 2, this labrig has interface 1"),
        (lambda: find_section(DRIVES, "sound", AxisDescription), PluginError, "is no section .* of AxisDescription"),
        (lambda: find_plugins(CAMERAS), MachineError, "not registered.*pip install -e ."),
    ],
    ids=("unknown", "claimed twice", "broken", "newer", "another kind", "older than the code"),
)  # fmt: skip
def test_what_cannot_be_used_is_refused_by_name(
    site: Path, find: Callable[[], object], error: type[LabrigError], words: str
) -> None:
    """With what is installed, both packages, or the package and its version; the rest is found all the same."""
    with pytest.raises(error) as refusal:
        find()
    told = f"{refusal.value.message} {refusal.value.hint}"
    assert re.search(words, told), told
    assert find_plugin(DRIVES, "epos2").load()
