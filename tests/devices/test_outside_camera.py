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


def _install(site: Path, package: str, module: str, code: str) -> None:
    """Install a package with one camera."""
    install_package(site, package, f"[labrig.cameras]\nlab-grey = {module}:CAMERA\n", module, code, "2.1")


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Yield a folder of installed packages."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    yield folder
    find_plugins.cache_clear()


def _drivers() -> Any:
    """Return the cameras that the schema of rig files knows."""
    schema: Any = rig_schema()
    return schema["properties"]["camera"]["discriminator"]["mapping"]


def _rig_file(folder: Path) -> Path:
    before, rest = SIMULATED.read_text(encoding="utf-8").split("camera:\n", 1)
    path = folder / "rig.yaml"
    path.write_text(before + SECTION + rest.split("\n\n", 1)[1], encoding="utf-8")
    return path


def test_it_is_chosen_by_name_and_has_its_own_keys(site: Path, tmp_path: Path) -> None:
    """No file of labrig names it."""
    _install(site, "lab_grey", "lab_grey_camera_1", MODULE)
    section = load_rig(_rig_file(tmp_path)).camera
    exposure = section.open(CameraContext(SimulatedClock())).read()
    assert exposure is not None
    assert exposure.image.mean() == 7.0
    assert "lab-grey" in _drivers()


def test_an_unknown_key_of_it_has_line_and_suggestion(site: Path, tmp_path: Path) -> None:
    """The error suggests the key that was probably meant."""
    _install(site, "lab_grey", "lab_grey_camera_2", MODULE)
    path = _rig_file(tmp_path)
    path.write_text(path.read_text(encoding="utf-8").replace("grey_level", "gray_level"), encoding="utf-8")
    with pytest.raises(FileFormatError, match=r"rig.yaml:\d+:3 camera.gray_level: unknown key") as refusal:
        load_rig(path)
    assert refusal.value.hint == "did you mean grey_level?"


def test_an_unknown_driver_lists_those_installed(tmp_path: Path) -> None:
    """The error has file, line and column of the name."""
    with pytest.raises(
        FileFormatError, match=r"rig.yaml:\d+:11 camera.driver: driver is .lab-grey.*files"
    ) as refusal:
        load_rig(_rig_file(tmp_path))
    assert refusal.value.exit_code == 2


def test_a_name_that_two_packages_claim_is_refused(site: Path, tmp_path: Path) -> None:
    """Both are named, and neither is used."""
    _install(site, "lab_grey", "lab_grey_camera_3", MODULE)
    _install(site, "other_grey", "lab_grey_camera_4", MODULE)
    with pytest.raises(
        FileFormatError, match=r"rig.yaml:\d+:11 .*claimed by .*lab.grey 2.1 and other.grey 2.1"
    ):
        load_rig(_rig_file(tmp_path))


@pytest.mark.parametrize(
    ("module", "code", "words"),
    [
        (
            "lab_grey_camera_5",
            "import a_module_that_is_not_there\n",
            "cannot be imported: ModuleNotFoundError",
        ),
        ("lab_grey_camera_6", f"{MODULE}\nSection.interface = 2\n", "is written for interface 2"),
        ("lab_grey_camera_7", "class CAMERA:\n    interface = 1\n", "is no section of a rig file"),
    ],
)
def test_a_package_that_fails_affects_only_its_camera(
    site: Path, tmp_path: Path, module: str, code: str, words: str
) -> None:
    """Other rig files load, and the schema omits it."""
    _install(site, "lab_grey", module, code)
    with pytest.raises(FileFormatError, match=f"camera lab-grey of package lab.grey 2.1 {words}"):
        load_rig(_rig_file(tmp_path))
    assert load_rig(SIMULATED).camera.driver == "simulated"
    assert "lab-grey" not in _drivers()
