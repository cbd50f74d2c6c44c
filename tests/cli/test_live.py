"""`labrig run --live`."""

import re
import signal
import subprocess
import sys
from http import HTTPStatus
from pathlib import Path
from urllib.request import urlopen

import pytest

from labrig.cli.live import Follower
from labrig.cli.options import complete_live
from labrig.record.check import check_run
from tests.analysis.synthetic import SyntheticSweep, record_sweep
from tests.cli.conftest import ROOT, Labrig
from tests.cli.example_runs import of_protocol


def _run(labrig: Labrig, runs_dir: Path, *options: str) -> Path:
    done = labrig("run", *of_protocol("steerability"), "--runs-dir", runs_dir, "--run-name", "run", *options)
    assert done.exit_code == 0, done.err
    return runs_dir / "run"


def test_a_run_shown_live_is_the_same_run(
    labrig: Labrig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Record and replay are those of the run that nobody watched; view.rrd is kept."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    watched = _run(labrig, tmp_path / "a", "--live")
    alone = _run(labrig, tmp_path / "b")
    for name in ("frames.jsonl", "states.jsonl", "events.jsonl", "protocol.yaml"):
        assert (watched / name).read_bytes() == (alone / name).read_bytes()
    assert (watched / "view.rrd").stat().st_size > 10_000
    assert not (alone / "view.rrd").exists()
    assert check_run(watched).damage == ()
    assert labrig("replay", watched, "--json").json()["identical"] is True


@pytest.mark.parametrize("program", ["stalled", "missing"])
def test_a_viewer_that_fails_is_told_once(
    program: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One that accepts and never reads, or does not start, leaves the record as it is."""
    viewer = tmp_path / "rerun"
    if program == "stalled":
        viewer.write_text(
            f"#!/bin/sh\ncd '{ROOT}' && exec '{sys.executable}' -m tests.cli.stalled_viewer \"$@\"\n"
        )
    else:
        viewer.write_text("#!/bin/sh\nexit 1\n")
    viewer.chmod(0o755)
    run = record_sweep(tmp_path, SyntheticSweep(radii_mm={"gel": (28.0,)}, gelatin_percent=(13,)))
    follower = Follower("viewer", str(viewer))
    follower.follow(run.path)
    follower.finish(3.0 if program == "stalled" else 120.0)
    said = [line for line in capsys.readouterr().err.splitlines() if "live view: nothing" in line]
    assert len(said) == (0 if program == "stalled" else 1)
    assert check_run(run.path).damage == ()


@pytest.mark.slow
def test_a_browser_is_told_before_the_run_and_stays_after_it(tmp_path: Path) -> None:
    """Until Ctrl+C the page is served; then the run's exit code is returned."""
    command = (sys.executable, "-m", "labrig", "run", *of_protocol("steerability"), "--live", "web")
    with subprocess.Popen(
        [*map(str, command), "--runs-dir", str(tmp_path), "--run-name", "run"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stderr is not None
        said = []
        for line in process.stderr:
            said.append(line)
            if "stays open" in line:
                break
        opened, *_ = (number for number, line in enumerate(said) if "live view: open http" in line)
        assert not any("elapsed" in line for line in said[:opened])
        page = re.search(r"http://\S+", said[opened])
        assert page is not None
        with urlopen(page[0]) as reply:
            assert reply.status == HTTPStatus.OK
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0


@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        (["run", "--live", "p.yaml"], ["run", "--live", "viewer", "p.yaml"]),
        (["run", "p.yaml", "--live"], ["run", "p.yaml", "--live", "viewer"]),
        (["run", "p.yaml", "--live", "web", "--yes"], ["run", "p.yaml", "--live", "web", "--yes"]),
    ],
)
def test_live_alone_is_the_viewer(typed: list[str], completed: list[str]) -> None:
    """The parser knows no option whose value may be left out."""
    assert complete_live(typed) == completed


def test_a_run_that_nobody_watches_loads_no_viewer() -> None:
    """Neither does the process that moves the axes when it is watched."""
    code = "import sys, labrig.library.door, labrig.cli.attendant; sys.exit('rerun' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
