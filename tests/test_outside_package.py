"""A package that somebody else wrote: the manual's example, built outside of the tree and installed beside labrig."""

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLE = "labrig/manual/example"
QUIET = {
    name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "LABRIG", "COV"))
}


@dataclass(frozen=True)
class Installed:
    """An environment with labrig's wheel and that of the example, and the folder of the example."""

    environment: Path
    example: Path

    def call(self, *command: object, exit_code: int = 0) -> str:
        """Run a program of the environment in the folder of the example, and return its standard output."""
        program, *arguments = map(str, command)
        done = subprocess.run(
            [self.environment / "bin" / program, *arguments],
            cwd=self.example,
            capture_output=True,
            text=True,
            env=QUIET,
            check=False,
            timeout=300,
        )
        assert done.returncode == exit_code, done.stdout + done.stderr
        return done.stdout


def _build_wheel(source: Path, folder: Path) -> None:
    """Build a wheel without the network: `pip wheel` would fetch the build backend first."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=source, capture_output=True, check=True, timeout=300)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    """Build both wheels and install them into a new environment, which takes the dependencies from this one."""
    folder = tmp_path_factory.mktemp("outside")
    wheels, environment = folder / "wheels", folder / "environment"
    _build_wheel(ROOT, wheels)
    (wheel,) = wheels.glob("labrig-*.whl")
    with zipfile.ZipFile(wheel) as packed:
        packed.extractall(folder, [name for name in packed.namelist() if name.startswith(EXAMPLE)])
    example = Path(shutil.move(folder / EXAMPLE, folder / "example"))
    _build_wheel(example, wheels)
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", environment], check=True, timeout=300)
    pip = [sys.executable, "-m", "pip", "--python", str(environment / "bin" / "python"), "install", "--quiet"]
    subprocess.run(
        [
            *pip,
            "--no-deps",
            "--no-index",
            "--no-compile",
            "--disable-pip-version-check",
            *wheels.glob("*.whl"),
        ],
        check=True,
        timeout=300,
    )
    (site,) = environment.glob("lib/python*/site-packages")
    here = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    (site / "dependencies.pth").write_text("\n".join(sorted(here)), encoding="utf-8")
    return Installed(environment, example)


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
    page = (installed.example / ran["report"]).read_text(encoding="utf-8")
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
    assert len((installed.example / "tables" / "visits.csv").read_text(encoding="utf-8").splitlines()) == 5


def test_its_drive_and_its_camera_pass_the_tests_of_every_driver(installed: Installed) -> None:
    """`labrig.testing` holds a lab's drivers to what labrig's own are held to."""
    passed = installed.call("python", "-m", "pytest", "-q", "-p", "no:cacheprovider")
    assert re.search(r"^\d\d passed", passed, re.MULTILINE), passed
