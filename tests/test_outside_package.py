"""labrig installed away from its checkout: from its sdist alone, and from its wheel with a package of somebody else."""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from dataclasses import dataclass
from pathlib import Path

import pytest
from packaging.metadata import Metadata

from labrig.lab.examples import read_examples
from labrig.record.source_digest import digest_sources

ROOT = Path(__file__).parents[1]
EXAMPLE = "labrig/manual/example"
QUIET = {
    name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "LABRIG", "COV"))
}


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


def _build(source: Path, folder: Path, *kinds: str) -> None:
    """Build distributions without the network, as `pip wheel` would fetch the build backend first, and without git."""
    targets = [word for kind in kinds for word in ("-t", kind)]
    command = [sys.executable, "-m", "hatchling", "build", *targets, "-d", str(folder)]
    quiet = {**QUIET, "PATH": ""}
    subprocess.run(command, cwd=source, capture_output=True, check=True, env=quiet, timeout=300)


def _install(environment: Path, *distributions: Path) -> None:
    """Install into a new environment, which takes the dependencies, and what builds an sdist, from this one."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", environment], check=True, timeout=300)
    (site,) = environment.glob("lib/python*/site-packages")
    here = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    (site / "dependencies.pth").write_text("\n".join(sorted(here)), encoding="utf-8")
    pip = [sys.executable, "-m", "pip", "--python", str(environment / "bin" / "python"), "install", "--quiet"]
    offline = [
        "--no-deps",
        "--no-index",
        "--no-build-isolation",
        "--no-compile",
        "--disable-pip-version-check",
    ]
    # Without the option, pip takes the labrig that this environment has for the one that is wanted.
    subprocess.run([*pip, *offline, "--ignore-installed", *distributions], check=True, timeout=300)


@pytest.fixture(scope="module")
def distributions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build labrig's wheel and its sdist."""
    folder = tmp_path_factory.mktemp("distributions")
    _build(ROOT, folder, "wheel", "sdist")
    return folder


@pytest.fixture(scope="module")
def installed(distributions: Path, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    """Install labrig's wheel, and that of the example in it, which is built outside of the tree."""
    folder = tmp_path_factory.mktemp("outside")
    (wheel,) = distributions.glob("labrig-*.whl")
    with zipfile.ZipFile(wheel) as packed:
        packed.extractall(folder, [name for name in packed.namelist() if name.startswith(EXAMPLE)])
    example = Path(shutil.move(folder / EXAMPLE, folder / "example"))
    _build(example, folder / "wheels", "wheel")
    _install(folder / "environment", wheel, *(folder / "wheels").glob("*.whl"))
    return Installed(folder / "environment", example)


@pytest.fixture(scope="module")
def alone(distributions: Path, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    """Install labrig's sdist, and make a lab folder with it."""
    folder = tmp_path_factory.mktemp("alone")
    (sdist,) = distributions.glob("labrig-*.tar.gz")
    _install(folder / "environment", sdist)
    assert json.loads(Installed(folder / "environment", folder).call("labrig", "init", "lab", "--json"))[
        "added"
    ]
    return Installed(folder / "environment", folder / "lab")


def test_a_lab_folder_of_an_installed_labrig_runs_its_protocols(alone: Installed) -> None:
    """Without the checkout: run, report and list of runs; the record says which code made it."""
    short = ("--set", "insertions_per_specimen=1", "--set", "specimens=[{name: A1, gelatin_percent: 10}]")
    ran = json.loads(alone.call("labrig", "run", "steerability", *short, "--json"))
    assert (ran["exit_status"], ran["result"]["specimens"][0]["n"]) == ("success", 1)
    assert Path(ran["run"]).parent == Path("data/runs")
    provenance = json.loads((alone.folder / ran["run"] / "manifest.json").read_text(encoding="utf-8"))[
        "provenance"
    ]
    assert (provenance["source_sha256"], provenance["git_commit"]) == (digest_sources(), None)
    page = (alone.folder / alone.call("labrig", "report", "last").strip()).read_text(encoding="utf-8")
    assert digest_sources() in page
    (listed,) = json.loads(alone.call("labrig", "runs", "--json"))
    assert listed["run"] == ran["run"]


def test_a_wheel_holds_what_an_sdist_holds(
    distributions: Path, installed: Installed, alone: Installed
) -> None:
    """The code, the examples and the licences are the same; the metadata is valid, its version that of the project."""
    described = (
        "import importlib.metadata as metadata, labrig; from labrig.lab.examples import read_examples;"
        "from labrig.record.source_digest import digest_sources; from hashlib import sha256;"
        "files = sorted(str(file) for file in metadata.files('labrig') if 'licenses' in file.parts);"
        "examples = sha256(repr(read_examples()).encode()).hexdigest();"
        "print(labrig.__file__, digest_sources(), examples, files, labrig.__version__, sep='\\n')"
    )
    found = [place.call("python", "-c", described).splitlines() for place in (installed, alone)]
    for place, lines in zip((installed, alone), found, strict=True):
        assert lines[0].startswith(str(place.environment))
    assert found[0][1:] == found[1][1:]
    examples = hashlib.sha256(repr(read_examples()).encode()).hexdigest()
    assert found[0][1:3] == [digest_sources(), examples]
    assert "LICENSE'" in found[0][3]
    assert "LICENSES.md" in found[0][3]
    (wheel,) = distributions.glob("labrig-*.whl")
    with zipfile.ZipFile(wheel) as packed:
        (stated,) = (name for name in packed.namelist() if name.endswith(".dist-info/METADATA"))
        assert Metadata.from_email(packed.read(stated), validate=True).author == "The labrig developers"
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert found[0][4] == project["version"]


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
    assert (replayed["identical"], replayed["bit_exact"]) == (True, True)
    changed = ("--set", "analysis.threshold=60")
    (again,) = json.loads(installed.call("labrig", "reanalyze", run, *changed, "--json"))
    assert again["first_divergence"]["key"] == "visits.0.u_px"
    installed.call("labrig", "export", run, "--csv", "--out", "tables")
    assert len((installed.folder / "tables" / "visits.csv").read_text(encoding="utf-8").splitlines()) == 5


def test_its_drive_and_its_camera_pass_the_tests_of_every_driver(installed: Installed) -> None:
    """`labrig.testing` holds a lab's drivers to what labrig's own are held to."""
    passed = installed.call("python", "-m", "pytest", "-q", "-p", "no:cacheprovider")
    assert re.search(r"^\d\d passed", passed, re.MULTILINE), passed
