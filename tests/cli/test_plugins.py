"""Packages with plugins on the command line: a broken one is named and stops nothing else."""

import importlib
import json
import re
import shutil
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from labrig.plugins import find_plugins
from tests.cli.conftest import RIG, ROOT, SWEEP, Done, Labrig
from tests.installing import install_package

EXAMPLE = ROOT / "labrig" / "manual" / "example"
ON_RIG = (SWEEP, "--rig", RIG, "--set", "insertions_per_specimen=1")
DECLARATION = """
from typing import Literal

from labrig.experiments import Experiment
from labrig.experiments.roll_zero.procedure import run
from labrig.experiments.roll_zero.protocol import RollZeroProtocol

class Protocol(RollZeroProtocol):
    experiment: Literal[{name!r}]

def measure(picture, protocol):
    return {{}}

EXPERIMENT = Experiment({name!r}, __name__)
{more}
"""
EVENT = """
from labrig.record.events import Event

class Turned(Event):
    roll_rad: float

def run(protocol, session):
    session.record(Turned(rol_rad=1.0))
"""


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Yield a folder of installed packages."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    yield folder
    find_plugins.cache_clear()


def _protocol(folder: Path, experiment: str) -> Path:
    text = (ROOT / "protocols" / "roll-zero.yaml").read_text(encoding="utf-8")
    path = folder / f"{experiment}.yaml"
    path.write_text(text.replace("experiment: roll-zero", f"experiment: {experiment}"), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("group", "name", "code", "words"),
    [
        ("experiments", "broken-import", "import a_missing_module\n", "cannot be imported: ModuleNotFoundError"),
        ("experiments", "broken-other", "class EXPERIMENT:\n    interface = 1\n", "expected an Experiment"),
        ("cameras", "broken-camera", "1 / 0\n", "cannot be imported: ZeroDivisionError"),
    ],
)  # fmt: skip
def test_a_plugin_that_fails_is_named_and_fatal_to_nothing(
    site: Path, tmp_path: Path, labrig: Labrig, group: str, name: str, code: str, words: str
) -> None:
    """`check` and `devices check` name it; a run or a rig without it is unaffected."""
    module = f"lab_{name}".replace("-", "_")
    install_package(site, "lab-package", f"[labrig.{group}]\n{name} = {module}:EXPERIMENT\n", module, code)
    checked = labrig("check", *ON_RIG, "--json")
    assert checked.exit_code == 0
    assert [words in fault["message"] for fault in checked.json()["plugins"]] == [True]
    assert f"note: {group[:-1]} {name} of package lab-package 1.5" in checked.err
    devices = labrig("devices", "check", "--rig", RIG, "--json").json()
    warned = [result for result in devices if result["check"] == "plugin"]
    assert [(result["status"], words in result["value"]) for result in warned] == [("WARN", True)]
    if group == "experiments":
        own = labrig("check", _protocol(tmp_path, name), "--rig", RIG)
        assert (own.exit_code, words in own.err) == (2, True)


@pytest.mark.parametrize(
    ("name", "more", "exit_code", "words"),
    [
        ("lacks-run", "del run\nrum = print", 2, r"has no run\(protocol, session\)"),
        ("lacks-measure", "mesure = measure\ndel measure", 2, r"has no measure\(picture, protocol\)"),
        (
            "mistyped", "def run(protocol, session):\n    session.reference_axis()\n", 1,
            r"'Session' object has no attribute 'reference_axis', in \S+lab_mistyped\.py, line 16",
        ),
        (
            "axis", "def run(protocol, session):\n    session.move('needle', 1.0, 1.0)\n", 1,
            r"there is no axis 'needle', only insertion, rotation, linear, in \S+lab_axis\.py, line 16",
        ),
        ("event", EVENT, 1, r"ValidationError: .* roll_rad Field required .*, in \S+lab_event\.py, line 22"),
    ],
)  # fmt: skip
def test_an_experiment_that_cannot_run_is_refused_before_anything_moves(
    site: Path, tmp_path: Path, labrig: Labrig, name: str, more: str, exit_code: int, words: str
) -> None:
    """`check` and `run` name the part or the line, and the package; no record is made."""
    module = f"lab_{name}".replace("-", "_")
    entry_points = f"[labrig.experiments]\n{name} = {module}:EXPERIMENT\n"
    install_package(site, "lab-package", entry_points, module, DECLARATION.format(name=name, more=more))
    for command, code in ((("check",), exit_code), (("run", "--runs-dir", tmp_path / "runs"), 2)):
        done = labrig(*command, _protocol(tmp_path, name), "--rig", RIG)
        told = " ".join((done.out + done.err).split())
        assert (done.exit_code, "lab-package" in told) == (code, True), told
        assert re.search(words, told), told
    assert not (tmp_path / "runs").exists()


def test_a_mistake_that_only_a_run_meets_is_told_with_its_line_and_the_record(
    site: Path, tmp_path: Path, labrig: Labrig
) -> None:
    """The package, the file, the line and the folder of what was recorded so far."""
    late = "def run(protocol, session):\n    if session.run_name != 'virtual':\n        session.reference_axis()\n"
    entry_points = "[labrig.experiments]\nlate = lab_late:EXPERIMENT\n"
    install_package(site, "lab-package", entry_points, "lab_late", DECLARATION.format(name="late", more=late))
    done = labrig("run", _protocol(tmp_path, "late"), "--rig", RIG, "--runs-dir", tmp_path / "runs")
    told, (run,) = " ".join(done.err.split()), (tmp_path / "runs").glob("*-late")
    assert done.exit_code == 2
    assert re.search(rf"lab-package .*lab_late\.py, line 17.*the record is {run}", told), told


MEASURING = """
import os

UNITS = {"u": "px"}

def run(protocol, session):
    for trial in session.trials([0]):
        with trial:
            session.reference_axes()
            session.move("insertion", 5.0, 5.0)
            session.take_picture()

def measure(picture, protocol):
    return eval(os.environ["LAB_FOUND"])

def conclude(protocol, rows):
    return eval(os.environ["LAB_CONCLUDED"], {"rows": rows})
"""


def test_what_a_package_measures_wrongly_is_its_own_fault(
    site: Path, tmp_path: Path, labrig: Labrig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The package is named and the record stays; what is no number is unknown."""
    entry_points = "[labrig.experiments]\nwrong = lab_wrong:EXPERIMENT\n"
    install_package(
        site, "lab-package", entry_points, "lab_wrong", DECLARATION.format(name="wrong", more=MEASURING)
    )

    def measure(found: str, concluded: str, *words: object) -> Done:
        monkeypatch.setenv("LAB_FOUND", found)
        monkeypatch.setenv("LAB_CONCLUDED", concluded)
        return labrig(*words, "--json")

    of_run = ("run", _protocol(tmp_path, "wrong"), "--rig", RIG, "--runs-dir", tmp_path / "runs")
    ran = measure("{'u': float('nan')}", "{'mean_px': float('nan'), 'rows': len(rows)}", *of_run)
    assert "then: the needle is in simulated gel" in ran.err  # its procedure did not take it out
    done = ran.json()
    told = (done["result"]["rows"][0]["u_px"], done["result"]["conclusion"])
    assert told == (None, {"mean_px": None, "rows": 1})
    for found, concluded, words in (
        ("[1.0]", "{}", "'list' object has no attribute 'keys'"),
        ("{'insertion_mm': 1.0}", "{}", "insertion_mm is a column of every picture"),
        ("{'u': (1.0, 2.0)}", "{}", "rows.0.u_px"),
        ("{'u': 1.0}", "None", "'NoneType' object has no attribute"),
    ):
        failed = measure(found, concluded, "reanalyze", done["run"])
        assert (failed.exit_code, "lab-package" in failed.err, words in failed.err) == (2, True, True), (
            failed.err
        )


def test_a_record_is_read_without_the_packages_that_made_it(
    site: Path, tmp_path: Path, labrig: Labrig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`runs`, `runs check`, `view`, `export` and tags work; other commands exit with 2 and name the package.

    With it, `compare` takes a column of its own.
    """
    monkeypatch.syspath_prepend(str(EXAMPLE))
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    groups = (
        "\n".join([f"[{group}]", *(f"{name} = {where}" for name, where in entries.items())])
        for group, entries in project["entry-points"].items()
    )
    install_package(site, project["name"], "\n".join(groups), version=project["version"])
    protocol = ("--rig", EXAMPLE / "rig.yaml", "--set", "visits=2", "--runs-dir", tmp_path)
    outside_run = tmp_path / "outside"
    assert labrig("run", EXAMPLE / "repeatability.yaml", *protocol, "--run-name", "outside").exit_code == 0
    by_trial = ("--quantity", "u_px", "--by", "trial", "--out", tmp_path / "compared", "--json")
    groups = labrig("compare", outside_run, *by_trial).json()["groups"]
    assert [(group["name"], group["n"]) for group in groups] == [("trial 1", 1), ("trial 2", 1)]
    recorded = json.loads((outside_run / "manifest.json").read_text(encoding="utf-8"))["plugins"]
    ours = ("experiment repeatability", "drive example-stepper", "camera example-marker")
    assert {name: recorded.pop(name) for name in ours} == dict.fromkeys(ours, "labrig-example 1.0.0")
    assert recorded.keys() == {"drive epos2"}
    entry_points = next(site.glob("labrig_example-*")) / "entry_points.txt"
    declared = entry_points.read_text(encoding="utf-8")
    for device in ("drive example-stepper", "camera example-marker"):
        entry_points.write_text(declared.replace(device.split()[1], "another"), encoding="utf-8")
        find_plugins.cache_clear()
        done = labrig("replay", outside_run)
        told = f"made with the {device} of package labrig-example 1.0.0, which is not installed"
        assert (done.exit_code, told in done.err) == (2, True)
    shutil.rmtree(entry_points.parent)
    importlib.invalidate_caches()
    find_plugins.cache_clear()
    for words in (
        f"runs --runs-dir {tmp_path}",
        "runs check",
        "runs annotate --tag good",
        "view --json",
        "export --format csv",
    ):
        named = () if "runs-dir" in words else (outside_run,)
        out = ("--out", tmp_path / "tables") if "export" in words else ()
        assert labrig(*words.split(), *named, *out).exit_code == 0, words
    for verb in ("report", "reanalyze", "replay", "resume"):
        done = labrig(verb, outside_run)
        lost = "experiment repeatability of package labrig-example 1.0.0, which is not installed"
        assert (done.exit_code, f"{outside_run} was made with the {lost}" in done.err) == (2, True)
