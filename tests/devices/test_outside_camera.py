"""A camera of another package: chosen by the rig file, with its own keys, and errors if it is missing."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from labrig.devices.camera import CameraContext
from labrig.devices.clocks import SimulatedClock
from labrig.devices.rig_file import load_rig, rig_schema
from labrig.errors import FileFormatError
from labrig.plugins import find_plugins
from tests.devices.rigs import SIMULATED
from tests.installing import install_package

MODULE = """
from typing import ClassVar, Literal

import numpy as np

from labrig.devices.camera import Exposure
from labrig.devices.camera import CameraDescription

class Section(CameraDescription):
    rig_kinds: ClassVar[frozenset[str]] = frozenset({"simulated", "bench"})
    driver: Literal["lab-grey"]
    grey_level: int

    def open(self, context):
        return Source(self)

class Source:
    exposures = 0

    def __init__(self, section):
        self._section = section

    def set(self, name, value):
        pass

    def get(self, name):
        return self._section.settings()[name]

    def read(self):
        self.exposures += 1
        section = self._section
        return Exposure(np.full((section.height_px, section.width_px), section.grey_level, np.uint8))

    def close(self):
        pass

CAMERA = Section
"""
SECTION = (
    "camera:\n  driver: lab-grey\n  width_px: 1280\n  height_px: 720\n  rate_hz: 30\n  grey_level: 7\n\n"
)


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Yield a folder of installed packages."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    yield folder
    find_plugins.cache_clear()


def _install(site: Path, module: str, code: str, package: str = "lab_grey") -> None:
    """Install a package with one camera."""
    install_package(site, package, f"[labrig.cameras]\nlab-grey = {module}:CAMERA\n", module, code, "2.1")


def _drivers() -> Any:
    """Return the cameras that the schema of rig files knows."""
    schema: Any = rig_schema()
    return schema["properties"]["camera"]["discriminator"]["mapping"]


def _rig_file(folder: Path, section: str = SECTION) -> Path:
    before, rest = SIMULATED.read_text(encoding="utf-8").split("camera:\n", 1)
    path = folder / "rig.yaml"
    path.write_text(before + section + rest.split("\n\n", 1)[1], encoding="utf-8")
    return path


def test_it_is_chosen_by_name_and_has_its_own_keys(site: Path, tmp_path: Path) -> None:
    """No file of labrig names it; an unknown key of it has its line, and the key that was probably meant."""
    _install(site, "lab_grey_camera_1", MODULE)
    exposure = load_rig(_rig_file(tmp_path)).camera.open(CameraContext(SimulatedClock())).read()
    assert exposure is not None
    assert exposure.image.mean() == 7.0
    assert "lab-grey" in _drivers()
    with pytest.raises(FileFormatError, match=r"rig.yaml:\d+:3 camera.gray_level: unknown key") as refusal:
        load_rig(_rig_file(tmp_path, SECTION.replace("grey_level", "gray_level")))
    assert refusal.value.hint == "did you mean grey_level?"


def test_a_name_that_nobody_or_two_packages_have_is_refused(site: Path, tmp_path: Path) -> None:
    """The error has the place of the name, and lists those installed or those that claim it."""
    with pytest.raises(FileFormatError, match=r"rig.yaml:\d+:3 camera.driver: driver is .lab-grey.*files"):
        load_rig(_rig_file(tmp_path))
    find_plugins.cache_clear()
    _install(site, "lab_grey_camera_3", MODULE)
    _install(site, "lab_grey_camera_4", MODULE, "other_grey")
    with pytest.raises(FileFormatError, match=r":3 .*claimed by .*lab.grey 2.1 and other.grey 2.1"):
        load_rig(_rig_file(tmp_path))


def test_a_package_that_fails_affects_only_its_camera(site: Path, tmp_path: Path) -> None:
    """Other rig files load, and the schema omits it."""
    _install(site, "lab_grey_camera_5", "import a_module_that_is_not_there\n")
    with pytest.raises(FileFormatError, match=r"camera lab-grey of package lab.grey 2.1 cannot be imported"):
        load_rig(_rig_file(tmp_path))
    assert load_rig(SIMULATED).camera.driver == "simulated"
    assert "lab-grey" not in _drivers()
