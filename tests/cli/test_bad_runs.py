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
Spoil = Callable[[Path], object]


def _newer(run: Path) -> None:
    document = json.loads((run / "manifest.json").read_text(encoding="utf-8")) | {"schema_version": 99}
    (run / "manifest.json").write_bytes(encode_manifest(document))


def _file(run: Path) -> None:
    shutil.rmtree(run)
    run.write_text("no run")


def _link(name: str) -> Spoil:
    """Return what moves a part of a run, or all of it, out of the folder of runs, and puts a link into its place."""

    def spoil(run: Path) -> None:
        place, elsewhere = run / name, run.parents[1] / "outside" / (Path(name).name or "run")
        if place.exists():
            place.rename(elsewhere)
        else:
            elsewhere.mkdir() if name == "analysis" else elsewhere.write_text("precious")
        place.symlink_to(elsewhere)

    return spoil


NO_RUN = "größe 2  run"
MEASURING = frozenset({"annotate", "reanalyze"})
DAMAGE: Mapping[str, tuple[Spoil, str, frozenset[str]]] = {
    "a folder": (lambda run: (run / "manifest.json").unlink(), NO_RUN, frozenset()),
    "a file": (_file, NO_RUN, frozenset()),
    "nothing": (shutil.rmtree, NO_RUN, frozenset()),
    "a link": (_link(""), NO_RUN, frozenset()),
    "newer": (_newer, NO_RUN, frozenset()),
    "a lost picture": (lambda run: (run / "frames" / "000001.png").unlink(), "frames/000001.png", MEASURING),
    "changed states": (lambda run: flip_bit(run / "states.jsonl"), "states.jsonl", MEASURING),
    "a changed protocol": (lambda run: flip_bit(run / "protocol.yaml"), "protocol.yaml", MEASURING),
    "no sums": (lambda run: (run / "SHA256SUMS").unlink(), "SHA256SUMS", MEASURING),
    "linked states": (_link("states.jsonl"), "states.jsonl", MEASURING),
    "a linked folder": (_link("calibration"), "calibration", MEASURING),
    "linked results": (
        _link("analysis"), "analysis is a symbolic link",
        frozenset(COMMANDS) - {"reanalyze", "report", "view", "export csv", "show"},
    ),
}  # fmt: skip
"""What happened to a run, what is said of it, and the commands that do not read that part."""


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


def spoil_copy(whole: Path, tmp_path: Path, how: Spoil) -> Path:
    """Return a spoilt copy of a run."""
    (tmp_path / "outside").mkdir()
    (tmp_path / "runs").mkdir()
    run = Path(shutil.copytree(whole, tmp_path / "runs" / NO_RUN))
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


@pytest.mark.parametrize("what", DAMAGE)
def test_every_command_names_what_it_cannot_use(
    what: str, whole: Path, labrig: Labrig, tmp_path: Path
) -> None:
    """Exit code 4 and the path, whatever else succeeds; links are not followed, and nothing recorded is changed."""
    how, named, others = DAMAGE[what]
    for number, command in enumerate(COMMANDS.keys() - others):
        (tmp_path / str(number)).mkdir()
        exit_code, said = call(labrig, command, spoil_copy(whole, tmp_path / str(number), how))
        assert (exit_code, named in said) == (4, True), (command, said)


def test_a_damaged_record_is_copied_only_when_forced(labrig: Labrig, tmp_path: Path) -> None:
    """Without --force nothing is written; with it the copy is byte for byte the damaged record."""
    run, out = closed_run(tmp_path / "runs"), tmp_path / "out"
    flip_bit(run / "frames" / "000001.png")
    refused = labrig("export", run, "--format", "record", "--out", out)
    assert (refused.exit_code, "--force copies it as it is" in refused.err, out.exists()) == (4, True, False)
    forced = labrig("export", run, "--format", "record", "--out", out, "--force", "--json")
    assert (forced.exit_code, forced.json()["ok"]) == (4, False)
    assert contents(out) == contents(run)


@pytest.mark.parametrize(("command", "name"), [("report", "report.html"), ("view", "view.rrd")])
def test_output_replaces_a_link_and_not_its_target(
    command: str, name: str, whole: Path, labrig: Labrig, tmp_path: Path
) -> None:
    """Page and view are written in place of a link; the file behind it is unchanged."""
    run = spoil_copy(whole, tmp_path, _link(name))
    assert call(labrig, command, run)[0] == 0
    assert not (run / name).is_symlink()
