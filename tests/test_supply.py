"""What labrig is installed from, and labrig away from the checkout: from its wheel, with a package of somebody else."""

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
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from labrig.lab import read_examples
from labrig.record.provenance import digest_sources

ROOT = Path(__file__).parents[1]
LOCK = ROOT / "tests" / "devices" / "outside_client" / "package-lock.json"
PINS = ROOT / "constraints.txt"


def _find_needed(*extras: str) -> set[str]:
    """Return the canonical names of all that labrig needs here, with those extras."""
    needed, left = set[str](), [Requirement(f"labrig[{','.join(extras)}]")]
    while left:
        wanted = left.pop()
        for text in metadata.requires(wanted.name) or ():
            found = Requirement(text)
            holds = [
                found.marker is None or found.marker.evaluate({"extra": extra})
                for extra in ("", *wanted.extras)
            ]
            if any(holds) and (canonicalize_name(found.name) not in needed or found.extras):
                needed.add(canonicalize_name(found.name))
                left.append(found)
    return needed


def test_all_that_labrig_needs_is_pinned() -> None:
    """What labrig and its development need, whoever asks for it, is in constraints.txt."""
    pins = re.findall(r"^([\w.-]+)==", PINS.read_text(encoding="utf-8"), re.MULTILINE)
    assert _find_needed("dev", "testing") <= set(map(canonicalize_name, pins))


def test_nothing_names_an_index(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where packages come from is for whoever installs them; a labrig on an index would be somebody else's."""
    monkeypatch.chdir(ROOT)
    pages = [
        *map(Path, ("README.md", "CONTRIBUTING.md")),
        *Path("labrig").rglob("*.md"),
        *Path("labrig").rglob("*.py"),
    ]
    for files, pattern in (
        (
            (PINS, LOCK, LOCK.with_name("package.json"), "Makefile"),
            r"https?://|--(?:extra-)?index-url|--find-links",
        ),
        (pages, r"pip install ['\"]?labrig[^\w`]"),
    ):
        assert [file for file in files if re.search(pattern, Path(file).read_text(encoding="utf-8"))] == []


def test_the_outside_client_is_pinned_by_integrity() -> None:
    """Each npm package of the client has one version and its SHA-512, and no address."""
    packages = json.loads(LOCK.read_text(encoding="utf-8"))["packages"]
    wanted = json.loads(LOCK.with_name("package.json").read_text(encoding="utf-8"))["dependencies"]
    assert packages.pop("")["dependencies"] == wanted
    assert packages["node_modules/canopen"]["version"] == wanted["canopen"]
    for place, package in packages.items():
        assert (package["integrity"][:7], "resolved" in package) == ("sha512-", False), place


def test_a_copyleft_licence_comes_with_one_package() -> None:
    """Of the packages that labrig runs with, python-can alone has one, and the README says so."""
    copyleft = {
        name for name in _find_needed() if re.search(r"GPL|Mozilla|MPL|EPL|CDDL", _read_license(name))
    }
    assert copyleft == {"python-can"}
    assert metadata.metadata("python-can")["License-Expression"] == "LGPL-3.0-only"
    assert "LGPL-3.0-only" in (ROOT / "README.md").read_text(encoding="utf-8")


def _read_license(name: str) -> str:
    """Return what an installed package states of its licence, in its expression, its classifiers or its own words."""
    found = metadata.metadata(name)
    classifiers = [text for text in found.get_all("Classifier") or () if text.startswith("License ::")]
    stated = [*(found.get_all("License-Expression") or ()), *classifiers]
    return " ".join(stated or [text.partition("\n")[0] for text in found.get_all("License") or ()])


EXAMPLE = "labrig/manual/example"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
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
            cwd=self.folder, capture_output=True, text=True, env=QUIET, check=False, timeout=300,
        )  # fmt: skip
        assert done.returncode == exit_code, done.stdout + done.stderr
        return done.stdout


def _build_wheel(source: Path, folder: Path) -> None:
    """Build without the network, as `pip wheel` would fetch the build backend first, and without git."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=source, check=True, env={**QUIET, "PATH": ""}, timeout=300)


def _install(environment: Path, *wheels: Path) -> None:
    """Install into a new environment, which takes the dependencies, but not labrig, from this one."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", environment], check=True, timeout=300)
    (site,) = environment.glob("lib/python*/site-packages")
    dependencies = environment / "dependencies"
    dependencies.mkdir()
    hidden = {path.parts[0] for path in metadata.files("labrig") or ()}
    for here in {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}:
        for path in Path(here).iterdir():
            if path.name not in hidden:
                (dependencies / path.name).symlink_to(path)
    (site / "dependencies.pth").write_text(str(dependencies), encoding="utf-8")
    pip = [sys.executable, "-m", "pip", "--python", str(environment / "bin" / "python"), "install", "--quiet"]
    offline = [
        "--no-deps", "--no-index", "--no-build-isolation", "--no-compile", "--disable-pip-version-check",
    ]  # fmt: skip
    subprocess.run([*pip, *offline, *wheels], check=True, timeout=300)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    """Install labrig's wheel, and that of the example in it, which is built outside of the tree."""
    folder = tmp_path_factory.mktemp("outside")
    _build_wheel(ROOT, folder / "wheels")
    (wheel,) = (folder / "wheels").glob("*.whl")
    with zipfile.ZipFile(wheel) as packed:
        packed.extractall(folder, [name for name in packed.namelist() if name.startswith(EXAMPLE)])
    example = Path(shutil.move(folder / EXAMPLE, folder / "example"))
    _build_wheel(example, folder / "wheels")
    _install(folder / "environment", *(folder / "wheels").glob("*.whl"))
    return Installed(folder / "environment", example)


@pytest.mark.slow
def test_a_lab_folder_of_a_wheel_runs_its_protocols(installed: Installed) -> None:
    """Without a checkout: run, report and list of runs; the record says which code made it."""
    installed.call("labrig", "init", "wheel")
    lab = Installed(installed.environment, installed.folder / "wheel")
    short = ("--set", "insertions_per_specimen=1", "--set", "specimens=[{name: A1, gelatin_percent: 10}]")
    ran = json.loads(lab.call("labrig", "run", "steerability", *short, "--json"))
    assert (ran["exit_status"], ran["result"]["specimens"][0]["n"]) == ("success", 1)
    assert Path(ran["run"]).parent == Path("data/runs")
    provenance = json.loads((lab.folder / ran["run"] / "manifest.json").read_text())["provenance"]
    assert (provenance["source_sha256"], provenance["git_commit"]) == (digest_sources(), None)
    wanted = {canonicalize_name(Requirement(text).name) for text in PROJECT["dependencies"]}
    assert (provenance["labrig"], provenance["packages"].keys()) == (PROJECT["version"], wanted)
    page = (lab.folder / lab.call("labrig", "report", "last").strip()).read_text(encoding="utf-8")
    assert digest_sources() in page
    assert [row["run"] for row in json.loads(lab.call("labrig", "runs", "--json"))] == [ran["run"]]


@pytest.mark.slow
def test_a_wheel_holds_the_code_the_examples_and_the_licence(installed: Installed) -> None:
    """They are those of the checkout, and the version is that of the project."""
    described = (
        "import labrig; from hashlib import sha256; from importlib.metadata import files;"
        "from labrig.lab import read_examples; from labrig.record.provenance import digest_sources;"
        "print(labrig.__file__, digest_sources(), sha256(repr(read_examples()).encode()).hexdigest(),"
        "[file.name for file in files('labrig') if 'licenses' in file.parts], labrig.__version__, sep='\\n')"
    )
    where, *found = installed.call("python", "-c", described).splitlines()
    assert where.startswith(str(installed.environment))
    examples = hashlib.sha256(repr(read_examples()).encode()).hexdigest()
    assert found == [digest_sources(), examples, "['LICENSE']", PROJECT["version"]]


@pytest.mark.slow
def test_an_experiment_a_drive_and_a_camera_of_another_package_run(installed: Installed) -> None:
    """From the schema over the run to its report; then the record is checked, replayed, measured again and exported."""
    installed.call("labrig", "init", "lab")
    protocol, rig = (
        json.loads((installed.folder / "lab" / f"{name}.schema.json").read_text())
        for name in ("protocols/protocol", "calibration/rig")
    )
    assert {"bevel-turns", "repeatability", "steerability"} <= set(protocol["discriminator"]["mapping"])
    assert {"StepperAxis", "Epos2Axis", "MarkerDescription"} <= set(rig["$defs"])

    words = ("repeatability.yaml", "--rig", "rig.yaml", "--json")
    assert json.loads(installed.call("labrig", "check", *words))["ok"]
    ran = json.loads(installed.call("labrig", "run", *words, "--runs-dir", "runs"))
    result = ran["result"]
    found = (ran["exit_status"], result["conclusion"]["came_back"], len(result["rows"]))
    assert found == ("success", True, 4)
    page = (installed.folder / ran["report"]).read_text(encoding="utf-8")
    assert "4 of 4 pictures measured" in page
    assert page.count("<figcaption") == 4  # a picture of each visit; the stepper does not measure its current

    run = ran["run"]
    (sound,) = json.loads(installed.call("labrig", "runs", "check", run, "--json"))
    assert (sound["ok"], sound["damage"]) == (True, [])
    assert json.loads(installed.call("labrig", "replay", run, "--json"))["verdict"] == "identical"
    # It moves the first centre by 0.8 px, which is beyond the tolerance of pixels.
    changed = ("--set", "analysis.threshold=30")
    (again,) = json.loads(installed.call("labrig", "reanalyze", run, *changed, "--json"))
    assert again["first_difference"]["path"] == "rows.0.u_px"
    installed.call("labrig", "export", run, "--format", "csv", "--out", "tables")
    assert len((installed.folder / "tables" / "rows.csv").read_text(encoding="utf-8").splitlines()) == 5


@pytest.mark.slow
def test_its_drive_and_its_camera_pass_the_tests_of_every_driver(installed: Installed) -> None:
    """`labrig.testing` holds a lab's drivers to what labrig's own are held to."""
    passed = installed.call("python", "-m", "pytest", "-q", "-p", "no:cacheprovider")
    assert re.search(r"^\d\d passed", passed, re.MULTILINE), passed
