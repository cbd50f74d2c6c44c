"""The command line as a user has it: arguments in; exit code, standard output and standard error out."""

import contextlib
import io
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from labrig.cli.main import run_command
from tests.small_camera import CALIBRATED_SMALL_CAMERA, set_options

ROOT = Path(__file__).parents[2]
SWEEP = ROOT / "protocols" / "steerability.yaml"
RIG = ROOT / "calibration" / "rig-simulated.yaml"

_KEPT = ROOT / "tests" / "records" / "steerability" / "calibration"
KEPT_MAPPING = ("--intrinsics", _KEPT / "intrinsics.json", "--plane", _KEPT / "plane.json")
"""What turns pixels of the kept pictures into mm."""
SCENARIO = {
    "needle": {"radius_mm": 27.6, "diameter_mm": 1.2},
    "target": {"position_mm": [0, 5, 100], "tolerance_mm": 2},
    "obstacles": [{"position_mm": [0, -2, 35], "radius_mm": 8}, {"position_mm": [0, 6, 68], "radius_mm": 8}],
    "planar": True,
    "clearance_mm": 0.6,
    "max_arcs": 6,
    "max_length_mm": 130,
}
"""What `labrig plan` plans a path for."""


@dataclass(frozen=True)
class Done:
    """What a command left behind."""

    exit_code: int
    out: str
    err: str

    def json(self) -> Any:
        """Return standard output as the one JSON document that it has to be."""
        return json.loads(self.out)


Labrig = Callable[..., Done]


@pytest.fixture
def labrig(capsys: pytest.CaptureFixture[str]) -> Labrig:
    """Run a command line in this process."""

    def call(*arguments: object) -> Done:
        capsys.readouterr()
        exit_code = run_command([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return Done(exit_code, captured.out, captured.err)

    return call


def sweep_command(rig: Path, runs_dir: Path) -> list[str]:
    """Return the command line of the paper's sweep, for a process of its own."""
    return [
        sys.executable, "-m", "labrig", "run", str(SWEEP), "--rig", str(rig), "--runs-dir", str(runs_dir),
    ]  # fmt: skip


SHORT_SWEEP = (
    *("--set", "insertion.speed_mm_s=8", "--set", "insertion.frame_every_mm=10"),
    *("--set", "insertions_per_specimen=2"),
    *("--set", "specimens=[{name: gel-10, gelatin_percent: 10}, {name: gel-19, gelatin_percent: 19}]"),
)
SMALL_RIG = ("--rig", str(RIG), *set_options(*CALIBRATED_SMALL_CAMERA))
"""A simulated rig whose pictures take a tenth of the time."""
SMALL_SWEEP = (*SMALL_RIG, *SHORT_SWEEP, "--set", "insertion.length_mm=22")


@dataclass(frozen=True)
class SweepRun:
    """A short sweep that was run once: its folder and what `labrig run --json` printed."""

    run: Path
    document: dict[str, Any]


@pytest.fixture(scope="session")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> SweepRun:
    """Two insertions in each of two gels, run through the real command."""
    runs_dir, printed = tmp_path_factory.mktemp("runs with spaces, é"), io.StringIO()
    with contextlib.redirect_stdout(printed):
        assert run_command(["run", str(SWEEP), "--runs-dir", str(runs_dir), "--json", *SMALL_SWEEP]) == 0
    document = json.loads(printed.getvalue())
    return SweepRun(Path(document["run"]), document)
