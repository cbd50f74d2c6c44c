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
