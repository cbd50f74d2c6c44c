"""What packages add to labrig, found by their entry points."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from labrig.devices.axis_description import AxisDescription
from labrig.devices.driver_section import find_section
from labrig.errors import InputError, MachineError, PluginError
from labrig.plugins import CAMERAS, DRIVES, find_plugin, find_plugins
from tests.installing import install_package


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Yield a folder of installed packages."""
    monkeypatch.syspath_prepend(str(tmp_path))
    install_package(tmp_path, "labrig", "[labrig.drives]\nepos2 = labrig.devices.drives.epos2:DRIVE\n")
    yield tmp_path
    find_plugins.cache_clear()


def test_a_package_adds_a_drive_by_declaring_it(site: Path) -> None:
    """A declared drive is found by its name, with its package and version, and is loaded when it is asked for."""
    code = "class Kind:\n    interface = 1\n\nDRIVE = Kind()\n"
    install_package(
        site, "lab-drive", "[labrig.drives]\nlab-stepper = lab_stepper_1:DRIVE\n", "lab_stepper_1", code
    )
    plugin = find_plugin(DRIVES, "lab-stepper")
    assert (plugin.package, plugin.version) == ("lab-drive", "1.5")
    assert type(plugin.load()).__name__ == "Kind"


def test_an_unknown_name_lists_what_is_installed(site: Path) -> None:
    """A name that nobody declares is refused with the nearest one and all that are installed."""
    install_package(site, "lab-drive", "[labrig.drives]\nlab-stepper = lab_stepper_2:DRIVE\n")
    with pytest.raises(InputError, match="unknown drive 'lab-steper'") as refusal:
        find_plugin(DRIVES, "lab-steper")
    assert "did you mean lab-stepper?" in refusal.value.hint
    assert "epos2" in refusal.value.hint


def test_a_name_that_two_packages_claim_is_refused(site: Path) -> None:
    """Both packages are named and neither drive is used; others are still found."""
    install_package(site, "lab-one", "[labrig.drives]\nlab-stepper = lab_one:DRIVE\n")
    install_package(site, "lab-two", "[labrig.drives]\nlab-stepper = lab_two:DRIVE\n")
    with pytest.raises(InputError, match=r"lab-one 1\.5 and lab-two 1\.5"):
        find_plugin(DRIVES, "lab-stepper")
    assert len(find_plugins(DRIVES)["lab-stepper"]) == 2


@pytest.mark.parametrize(
    ("module", "code", "message"),
    [
        ("lab_broken", "1 / 0\n", r"drive odd of package lab-drive 1\.5 .*ZeroDivisionError"),
        ("lab_newer", "class DRIVE:\n    interface = 2\n", "for interface 2, this labrig has interface 1"),
    ],
)
def test_a_plugin_that_cannot_be_used_is_named(site: Path, module: str, code: str, message: str) -> None:
    """An import that fails, or another interface than labrig's: with drive, package and version."""
    install_package(site, "lab-drive", f"[labrig.drives]\nodd = {module}:DRIVE\n", module, code)
    with pytest.raises(PluginError, match=message):
        find_plugin(DRIVES, "odd").load()


def test_a_plugin_of_another_kind_is_refused(site: Path) -> None:
    """What is no section of an axis is named."""
    code = "class Stage:\n    interface = 1\n\nSTAGE = Stage()\n"
    install_package(site, "lab-stage", "[labrig.drives]\nstage = lab_stage:STAGE\n", "lab_stage", code)
    with pytest.raises(
        PluginError, match=r"stage of package lab-stage 1\.5 is no section .* subclass of AxisDescription"
    ):
        find_section(DRIVES, "stage", AxisDescription)


def test_an_installation_without_labrigs_own_says_what_to_run(site: Path) -> None:
    """Where labrig's own entry points are missing, the installation is older than the code."""
    install_package(site, "lab-drive", "[labrig.cameras]\nlab-camera = lab_camera:CAMERA\n")
    with pytest.raises(MachineError, match="not registered") as refusal:
        find_plugins(CAMERAS)
    assert "pip install -e ." in refusal.value.hint
