"""Away from the checkout: labrig from its wheel with a package of somebody else, and labrig-core from its sdist."""

import hashlib
import json
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from collections.abc import Collection
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import pytest
from packaging.markers import Marker
from packaging.metadata import Metadata
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from labrig.lab.examples import read_examples
from labrig.record.source_digest import digest_sources
from tests.distributions import QUIET, ROOT, build, build_both

EXAMPLE = "labrig/manual/example"
DESCRIBED = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = DESCRIBED["project"]
LEFT_OUT = set(DESCRIBED["tool"]["labrig"]["core-leaves-out"])


@dataclass(frozen=True)
class Installed:
    """An environment with labrig, and the folder in which its programs are called."""

    environment: Path
    folder: Path

    def call(self, *command: object, exit_code: int = 0) -> str:
        """Run a program of the environment in that folder, and return its standard output."""
        program, *arguments = map(str, command)
        done = subprocess.run(
            [self.environment / "bin" / program, *arguments],
            cwd=self.folder,
            capture_output=True,
            text=True,
            env=QUIET,
            check=False,
            timeout=300,
        )
        assert done.returncode == exit_code, done.stdout + done.stderr
        return done.stdout


def _install(environment: Path, *distributions: Path, without: Collection[str] = ()) -> None:
    """Install into a new environment, which takes the dependencies, and what builds an sdist, from this one.

    Neither the labrig of this environment is among them, nor the packages of `without`.
    """
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", environment], check=True, timeout=300)
    (site,) = environment.glob("lib/python*/site-packages")
    dependencies = environment / "dependencies"
    dependencies.mkdir()
    hidden = _find_files("labrig", *without)
    for here in {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}:
        for path in Path(here).iterdir():
            if path.name not in hidden:
                (dependencies / path.name).symlink_to(path)
    (site / "dependencies.pth").write_text(str(dependencies), encoding="utf-8")
    pip = [sys.executable, "-m", "pip", "--python", str(environment / "bin" / "python"), "install", "--quiet"]
    offline = [
        "--no-deps",
        "--no-index",
        "--no-build-isolation",
        "--no-compile",
        "--disable-pip-version-check",
    ]
    subprocess.run([*pip, *offline, *distributions], check=True, timeout=300)


def _find_files(*packages: str) -> set[str]:
    """Return the names of what these packages have put beside the others."""
    return {path.parts[0] for package in packages for path in metadata.files(package) or ()}


@pytest.fixture(scope="module")
def distributions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build wheel and sdist of labrig, and of labrig-core."""
    folder = tmp_path_factory.mktemp("distributions")
    build_both(folder)
    return folder


@pytest.fixture(scope="module")
def installed(distributions: Path, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    """Install labrig's wheel, and that of the example in it, which is built outside of the tree."""
    folder = tmp_path_factory.mktemp("outside")
    (wheel,) = distributions.glob("labrig-*.whl")
    with zipfile.ZipFile(wheel) as packed:
        packed.extractall(folder, [name for name in packed.namelist() if name.startswith(EXAMPLE)])
    example = Path(shutil.move(folder / EXAMPLE, folder / "example"))
    build(example, folder / "wheels", "wheel")
    _install(folder / "environment", wheel, *(folder / "wheels").glob("*.whl"))
    return Installed(folder / "environment", example)


@pytest.fixture(scope="module")
def core(distributions: Path, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    """Install labrig-core from its sdist, which is made of labrig's, and make a lab folder with it."""
    folder = tmp_path_factory.mktemp("core")
    (sdist,) = distributions.glob("labrig_core-*.tar.gz")
    _install(folder / "environment", sdist, without=LEFT_OUT)
    assert json.loads(Installed(folder / "environment", folder).call("labrig", "init", "lab", "--json"))[
        "added"
    ]
    return Installed(folder / "environment", folder / "lab")


def test_a_lab_folder_of_labrig_core_runs_its_protocols(core: Installed) -> None:
    """Without checkout and viewer: run, report and list of runs; the record says which code made it."""
    short = ("--set", "insertions_per_specimen=1", "--set", "specimens=[{name: A1, gelatin_percent: 10}]")
    ran = json.loads(core.call("labrig", "run", "steerability", *short, "--json"))
    assert (ran["exit_status"], ran["result"]["specimens"][0]["n"]) == ("success", 1)
    assert Path(ran["run"]).parent == Path("data/runs")
    provenance = json.loads((core.folder / ran["run"] / "manifest.json").read_text(encoding="utf-8"))[
        "provenance"
    ]
    assert (provenance["source_sha256"], provenance["git_commit"]) == (digest_sources(), None)
    assert provenance["labrig"] == PROJECT["version"]
    wanted = {canonicalize_name(Requirement(text).name) for text in PROJECT["dependencies"]}
    assert provenance["packages"].keys() == wanted - LEFT_OUT
    page = (core.folder / core.call("labrig", "report", "last").strip()).read_text(encoding="utf-8")
    assert digest_sources() in page
    (listed,) = json.loads(core.call("labrig", "runs", "--json"))
    assert listed["run"] == ran["run"]


def test_labrig_core_names_the_command_that_installs_a_viewer(core: Installed) -> None:
    """In a version that labrig is made for; nothing has run."""
    done = core.call("labrig", "run", "steerability", "--live", "web", "--json", exit_code=2)
    hint = json.loads(done)["error"]["hint"]
    wanted = Requirement(hint.removeprefix("pip install '").removesuffix("'"))
    assert wanted in [Requirement(text) for text in PROJECT["dependencies"]]
    assert metadata.version("rerun-sdk") in wanted.specifier


@dataclass(frozen=True)
class Wheel:
    """What a wheel installs, as a checksum of each file, and what it says of itself."""

    files: dict[str, int]
    described: Metadata

    @classmethod
    def read(cls, wheel: Path) -> "Wheel":
        """Read a wheel, of which the metadata must be valid."""
        with zipfile.ZipFile(wheel) as packed:
            checksums = {file.filename: file.CRC for file in packed.infolist()}
            (stated,) = (name for name in checksums if name.endswith(".dist-info/METADATA"))
            described = Metadata.from_email(packed.read(stated), validate=True)
        files = {name: checksum for name, checksum in checksums.items() if ".dist-info/" not in name}
        return cls(files, described)

    def find_needed(self, extra: str | None = None) -> set[str]:
        """Return what is needed always, or with an extra alone."""
        marker = None if extra is None else Marker(f"extra == '{extra}'")
        needed = (found for found in self.described.requires_dist or () if found.marker == marker)
        return {f"{found.name}{found.specifier}" for found in needed}


def test_labrig_core_is_labrig_with_fewer_dependencies(distributions: Path) -> None:
    """Both wheels hold the same files; what labrig alone needs is an extra of labrig-core."""
    labrig, core = (Wheel.read(*distributions.glob(f"{name}-*.whl")) for name in ("labrig", "labrig_core"))
    assert (labrig.described.name, core.described.name) == ("labrig", "labrig-core")
    assert labrig.described.author == core.described.author == "The labrig developers"
    assert labrig.files == core.files
    more = labrig.find_needed() - core.find_needed()
    assert {Requirement(text).name for text in more} == LEFT_OUT
    assert core.find_needed("full") == more


def test_the_wheel_of_labrig_core_makes_a_lab_folder(distributions: Path, tmp_path: Path) -> None:
    """Installed by itself, with none of what labrig-core leaves out, it is the program that makes and checks one."""
    (wheel,) = distributions.glob("labrig_core-*.whl")
    _install(tmp_path / "environment", wheel, without=LEFT_OUT)
    outside = Installed(tmp_path / "environment", tmp_path)
    assert outside.call("labrig", "--version") == f"labrig {PROJECT['version']}\n"
    where = "import labrig; print(labrig.__file__)"
    assert outside.call("python", "-c", where).startswith(str(outside.environment))
    assert json.loads(outside.call("labrig", "init", "lab", "--json"))["added"]
    within = Installed(outside.environment, tmp_path / "lab")
    assert json.loads(within.call("labrig", "check", "steerability", "--json"))["ok"]


def test_a_wheel_holds_what_an_sdist_holds(installed: Installed, core: Installed) -> None:
    """The code, the examples and the licences are the same, and the version is that of the project."""
    described = (
        "import labrig; from hashlib import sha256; from labrig.lab.examples import read_examples;"
        "from labrig.distribution import find_own_distribution; from labrig.record.source_digest import digest_sources;"
        "files = sorted(file.name for file in find_own_distribution().files if 'licenses' in file.parts);"
        "examples = sha256(repr(read_examples()).encode()).hexdigest();"
        "print(labrig.__file__, digest_sources(), examples, files, labrig.__version__, sep='\\n')"
    )
    found = [place.call("python", "-c", described).splitlines() for place in (installed, core)]
    for place, lines in zip((installed, core), found, strict=True):
        assert lines[0].startswith(str(place.environment))
    assert found[0][1:] == found[1][1:]
    examples = hashlib.sha256(repr(read_examples()).encode()).hexdigest()
    assert found[0][1:3] == [digest_sources(), examples]
    assert found[0][3] == "['LICENSE', 'LICENSES.md']"
    assert found[0][4] == PROJECT["version"]


def test_an_experiment_a_drive_and_a_camera_of_another_package_run(installed: Installed) -> None:
    """From the schema over the run to its report; then the record is checked, replayed, measured again and exported."""
    where = installed.call("python", "-c", "import labrig, labrig_example; print(labrig.__file__)")
    assert where.startswith(str(installed.environment))
    assert "RepeatabilityProtocol" in json.loads(installed.call("labrig", "schema"))["$defs"]
    rig = json.loads(installed.call("labrig", "schema", "rig"))["$defs"]
    assert {"StepperAxis", "Epos2Axis", "MarkerDescription"} <= set(rig)

    protocol = ("repeatability.yaml", "--rig", "rig.yaml")
    assert json.loads(installed.call("labrig", "check", *protocol, "--json"))["ok"]
    ran = json.loads(installed.call("labrig", "run", *protocol, "--runs-dir", "runs", "--json"))
    assert (ran["exit_status"], ran["result"]["accepted"], len(ran["result"]["visits"])) == (
        "success",
        True,
        4,
    )
    page = (installed.folder / ran["report"]).read_text(encoding="utf-8")
    assert "The marker came back" in page
    assert "Motor current" in page
    assert page.count("<figcaption") == 4 + 1  # a picture of each visit, and the motor currents

    run = ran["run"]
    (sound,) = json.loads(installed.call("labrig", "runs", "check", run, "--json"))
    assert (sound["ok"], sound["damage"]) == (True, [])
    replayed = json.loads(installed.call("labrig", "replay", run, "--json"))
    assert replayed["verdict"] == "identical"
    changed = ("--set", "analysis.threshold=60")
    (again,) = json.loads(installed.call("labrig", "reanalyze", run, *changed, "--json"))
    assert again["first_divergence"]["key"] == "visits.0.u_px"
    installed.call("labrig", "export", run, "--csv", "--out", "tables")
    assert len((installed.folder / "tables" / "visits.csv").read_text(encoding="utf-8").splitlines()) == 5


def test_its_drive_and_its_camera_pass_the_tests_of_every_driver(installed: Installed) -> None:
    """`labrig.testing` holds a lab's drivers to what labrig's own are held to."""
    passed = installed.call("python", "-m", "pytest", "-q", "-p", "no:cacheprovider")
    assert re.search(r"^\d\d passed", passed, re.MULTILINE), passed
