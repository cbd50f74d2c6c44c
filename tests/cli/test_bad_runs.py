"""Every command that takes a run, given what is none, is damaged, or leads elsewhere by a link."""

import hashlib
import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from labrig.record.json_lines import encode_manifest
from tests.cli.conftest import Labrig
from tests.record.runs import closed_run, flip_bit

COMMANDS: Mapping[str, tuple[str, ...]] = {
    "check": ("runs", "check", "RUN"),
    "show": ("runs", "show", "RUN"),
    "resume": ("resume", "RUN"),
    "replay": ("replay", "RUN"),
    "reanalyze": ("reanalyze", "RUN"),
    "report": ("report", "RUN"),
    "view": ("view", "RUN", "--json"),
    "export csv": ("export", "RUN", "--format", "csv", "--out", "TABLES"),
    "export record": ("export", "RUN", "--format", "record", "--out", "TABLES"),
    "annotate": ("runs", "annotate", "RUN", "--tag", "pilot", "--note", "cloudy"),
    "adopt": ("calibrate", "adopt", "RUN"),
}


def _newer(run: Path) -> None:
    document = json.loads((run / "manifest.json").read_text(encoding="utf-8")) | {"schema_version": 99}
    (run / "manifest.json").write_bytes(encode_manifest(document))


def _file(run: Path) -> None:
    shutil.rmtree(run)
    run.write_text("no run")


def _elsewhere(run: Path) -> None:
    outside = run.parents[1] / "outside" / "run"
    run.rename(outside)
    run.symlink_to(outside)


def _link(name: str) -> Callable[[Path], None]:
    """Return what moves a file or folder of a run out of the folder of runs, and puts a link into its place."""

    def spoil(run: Path) -> None:
        place, elsewhere = run / name, run.parents[1] / "outside" / Path(name).name
        if place.exists():
            place.rename(elsewhere)
        else:
            elsewhere.write_text("precious")
        place.symlink_to(elsewhere)

    return spoil


NO_RUNS: Mapping[str, Callable[[Path], None]] = {
    "a folder": lambda run: (run / "manifest.json").unlink(),
    "a file": _file,
    "nothing": shutil.rmtree,
    "a link": _elsewhere,
    "newer": _newer,
}
DAMAGED: Mapping[str, Callable[[Path], None]] = {
    "frames/000001.png is missing": lambda run: (run / "frames" / "000001.png").unlink(),
    "states.jsonl does not fit": lambda run: flip_bit(run / "states.jsonl"),
    "protocol.yaml does not fit": lambda run: flip_bit(run / "protocol.yaml"),
    "SHA256SUMS cannot be read": lambda run: (run / "SHA256SUMS").unlink(),
    "states.jsonl is a symbolic link": _link("states.jsonl"),
    "calibration is a symbolic link": _link("calibration"),
}


def contents(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of each file that a command may not change."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.is_symlink() and not path.name.startswith(".")
    }


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that is as it was written."""
    return closed_run(tmp_path_factory.mktemp("whole"))


def spoil(whole: Path, tmp_path: Path, how: Callable[[Path], None]) -> Path:
    """Return a spoilt copy of a run."""
    (tmp_path / "outside").mkdir()
    (tmp_path / "runs").mkdir()
    run = Path(shutil.copytree(whole, tmp_path / "runs" / "größe 2  run"))
    how(run)
    return run


def call(labrig: Labrig, command: str, run: Path) -> tuple[int, str]:
    """Carry out a command; nothing outside the run's folder, and nothing recorded, may be another afterwards."""
    outside, tables = run.parents[1] / "outside", run.parents[1] / "tables"
    before = contents(outside), ({} if run.is_symlink() else contents(run))
    words: Mapping[str, object] = {"RUN": run, "TABLES": tables}
    done = labrig(*(words.get(word, word) for word in COMMANDS[command]), "--json")
    assert "Traceback" not in done.err
    assert contents(outside) == before[0]
    after = {} if run.is_symlink() else contents(run)
    assert {name: after.get(name) for name in before[1]} == before[1]
    return done.exit_code, done.out + done.err


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("how", NO_RUNS.values(), ids=NO_RUNS.keys())
def test_a_folder_that_is_not_a_run_is_refused_by_name(
    command: str, how: Callable[[Path], None], whole: Path, labrig: Labrig, tmp_path: Path
) -> None:
    """Exit code 4 and the path; links and newer schemas are not read, nothing is written."""
    exit_code, said = call(labrig, command, spoil(whole, tmp_path, how))
    assert exit_code == 4
    assert "größe 2  run" in said


@pytest.mark.parametrize("command", [name for name in COMMANDS if name not in {"annotate", "reanalyze"}])
@pytest.mark.parametrize("words", DAMAGED)
def test_damage_is_reported_by_every_command(
    command: str, words: str, whole: Path, labrig: Labrig, tmp_path: Path
) -> None:
    """Exit code 4 and the file, whatever else succeeds."""
    exit_code, said = call(labrig, command, spoil(whole, tmp_path, DAMAGED[words]))
    assert exit_code == 4
    assert words.split(maxsplit=1)[0] in said


def test_a_damaged_record_is_copied_only_when_forced(labrig: Labrig, tmp_path: Path) -> None:
    """Without --force nothing is written; with it the copy is byte for byte the damaged record."""
    run, out = closed_run(tmp_path / "runs"), tmp_path / "out"
    flip_bit(run / "frames" / "000001.png")
    refused = labrig("export", run, "--format", "record", "--out", out)
    assert (refused.exit_code, "--force copies it as it is" in refused.err, out.exists()) == (4, True, False)
    forced = labrig("export", run, "--format", "record", "--out", out, "--force", "--json")
    assert (forced.exit_code, forced.json()["ok"]) == (4, False)
    assert contents(out) == contents(run)


@pytest.mark.parametrize("command", ["reanalyze", "report", "view", "export csv", "show"])
def test_results_behind_a_link_are_not_read(
    command: str, whole: Path, labrig: Labrig, tmp_path: Path
) -> None:
    """A results folder that is a link is refused with exit code 4; nothing is written there."""
    results = tmp_path / "results"
    results.mkdir()
    run = spoil(whole, tmp_path, lambda run: (run / "analysis").symlink_to(results))
    exit_code, said = call(labrig, command, run)
    assert exit_code == 4
    assert "analysis is a symbolic link" in said
    assert not list(results.iterdir())


@pytest.mark.parametrize(("command", "name"), [("report", "report.html"), ("view", "view.rrd")])
def test_output_replaces_a_link_and_not_its_target(
    command: str, name: str, whole: Path, labrig: Labrig, tmp_path: Path
) -> None:
    """Page and view are written in place of a link; the file behind it is unchanged."""
    run = spoil(whole, tmp_path, _link(name))
    assert call(labrig, command, run)[0] == 0
    assert not (run / name).is_symlink()
