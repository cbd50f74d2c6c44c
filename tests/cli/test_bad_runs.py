"""Every command that takes a run, given what is none, is damaged, or leads elsewhere by a link."""

import hashlib
import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from labrig.record.json_lines import checksum, encode_document, encode_line
from labrig.record.pictures import Store
from tests.cli.conftest import ROOT, Labrig
from tests.record.faults import flip_bit, full_run

FORMS = ("csv", "parquet", "mat", "record")
COMMANDS: Mapping[str, tuple[str, ...]] = {
    "check": ("runs", "check", "RUN"),
    "repair": ("runs", "check", "RUN", "--repair"),
    "resume": ("resume", "RUN"),
    "replay": ("replay", "RUN"),
    "reanalyze": ("reanalyze", "RUN"),
    "report": ("report", "RUN"),
    "view": ("view", "RUN", "--no-open"),
    **{f"export {form}": ("export", "RUN", f"--{form}", "--out", "TABLES") for form in FORMS},
    "diff": ("runs", "diff", "RUN", "GOOD"),
    "tag": ("runs", "tag", "RUN", "--tag", "pilot"),
    "note": ("runs", "note", "RUN", "cloudy"),
    "adopt": ("calibrate", "adopt", "RUN"),
    "from-run": ("design", "--from-run", "RUN"),
}
_SAY_ONLY = frozenset({"tag", "note"})
"""They append what a person says of a run, be it damaged."""

_PLACES = (
    "damaged",
    "missing",
    "No such file",
    "symbolic link",
    "goes backwards",
    "twice",
    "expected",
    "does not say",
)


def _empty(run: Path) -> None:
    (run / "manifest.json").unlink()


def _file(run: Path) -> None:
    shutil.rmtree(run)
    run.write_text("no run")


def _delete(run: Path) -> None:
    shutil.rmtree(run)


def _newer(run: Path) -> None:
    document = json.loads((run / "manifest.json").read_text(encoding="utf-8"))
    document |= {"schema_version": 99}
    del document["crc32"]
    (run / "manifest.json").write_bytes(encode_document({**document, "crc32": checksum(document)}))


def _rewrite(name: str, number: int, **fields: object) -> Callable[[Path], None]:
    """Return what gives a line other values, and the checksum that fits them."""

    def spoil(run: Path) -> None:
        lines = (run / name).read_bytes().splitlines(keepends=True)
        line = {key: value for key, value in json.loads(lines[number]).items() if key != "crc32"}
        lines[number] = encode_line(line | fields)
        (run / name).write_bytes(b"".join(lines))

    return spoil


def _without_a_picture(run: Path) -> None:
    (run / "frames" / "000001.png").unlink()


def _link(name: str) -> Callable[[Path], None]:
    """Return what moves a file or folder of a run out of the folder of runs, and puts a link into its place."""

    def spoil(run: Path) -> None:
        outside = run.parents[1] / "outside"
        place, elsewhere = run / name, outside / (Path(name).name or "run")
        if not place.exists():
            elsewhere.write_text("precious")
        else:
            place.rename(elsewhere)
        place.symlink_to(elsewhere)

    return spoil


def _run_elsewhere(run: Path) -> None:
    outside = run.parents[1] / "outside" / "run"
    run.rename(outside)
    run.symlink_to(outside)


NO_RUNS = {"a folder": _empty, "a file": _file, "nothing": _delete, "a link": _run_elsewhere, "newer": _newer}
DAMAGED = {
    "a picture missing": _without_a_picture,
    "a picture twice": _rewrite("frames.jsonl", 1, frame=0),
    "a clock that goes backwards": _rewrite("states.jsonl", 3, t_s=-1.0),
    **{
        f"a link for {name}": _link(name)
        for name in (
            "frames/000000.png",
            "states.jsonl",
            "calibration",
        )
    },
}


def _contents(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.is_symlink()
    }


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that is as it was written."""
    return full_run(tmp_path_factory.mktemp("whole"), closed=True)


def _call(labrig: Labrig, command: str, run: Path, whole: Path) -> tuple[int, str]:
    """Carry out a command; nothing outside the run's folder, and nothing recorded, may be another afterwards."""
    outside = run.parents[1] / "outside"
    before = _contents(outside), ({} if run.is_symlink() else _contents(run))
    chain = _read_chain(run)
    words = {"RUN": run, "GOOD": whole, "TABLES": run.parents[1] / "tables"}
    done = labrig(*(words.get(word, word) for word in COMMANDS[command]), "--json")
    assert "Traceback" not in done.err
    assert _contents(outside) == before[0]
    after = {} if run.is_symlink() else _contents(run)
    assert {name: after.get(name) for name in before[1] if name != "chain.jsonl"} == {
        name: sha256 for name, sha256 in before[1].items() if name != "chain.jsonl"
    }
    assert _read_chain(run).startswith(chain)
    document = json.loads(done.out)
    rows = document if isinstance(document, list) else [document]
    reasons = (row.get("reason") or row.get("error", {}).get("message") for row in rows)
    return done.exit_code, f"{' '.join(map(str, reasons))} {done.err}"


def _read_chain(run: Path) -> bytes:
    """Return the chain, to which a command may add what it does."""
    path = run / "chain.jsonl"
    return path.read_bytes() if path.is_file() else b""


def _damage(whole: Path, tmp_path: Path, spoil: Callable[[Path], None]) -> Path:
    (tmp_path / "outside").mkdir()
    (tmp_path / "runs").mkdir()
    run = Path(shutil.copytree(whole, tmp_path / "runs" / "größe 2  run"))
    spoil(run)
    return run


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("spoil", NO_RUNS.values(), ids=NO_RUNS.keys())
def test_a_folder_that_is_not_a_run_is_refused_by_name(
    command: str, spoil: Callable[[Path], None], whole: Path, labrig: Labrig, tmp_path: Path
) -> None:
    """Exit code 4 and the path; links and newer schemas are not read, nothing is written."""
    run = _damage(whole, tmp_path, spoil)
    exit_code, message = _call(labrig, command, run, whole)
    assert exit_code == 4
    assert "größe 2  run" in message


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("spoil", DAMAGED.values(), ids=DAMAGED.keys())
def test_damage_is_reported_by_every_command(
    command: str, spoil: Callable[[Path], None], whole: Path, labrig: Labrig, tmp_path: Path
) -> None:
    """Exit code 4 and the place, whatever else succeeds; only tags and notes ignore it."""
    exit_code, message = _call(labrig, command, _damage(whole, tmp_path, spoil), whole)
    if command in _SAY_ONLY:
        assert exit_code == 0
    else:
        assert exit_code == 4
        assert any(word in message for word in _PLACES)


@pytest.mark.parametrize("command", [name for name in COMMANDS if name not in {*_SAY_ONLY, "reanalyze"}])
@pytest.mark.parametrize(("store", "file"), [("png", "frames/000001.png"), ("raw", "frames.raw")])
def test_a_changed_picture_is_named_by_every_command(
    command: str, store: Store, file: str, labrig: Labrig, tmp_path: Path
) -> None:
    """One flipped bit ends each command with exit code 4 and the name of the file; there is nothing to measure here."""
    runs = [full_run(tmp_path / name / "runs", closed=True, store=store) for name in ("changed", "whole")]
    (tmp_path / "changed" / "outside").mkdir()
    flip_bit(runs[0] / file)
    exit_code, said = _call(labrig, command, *runs)
    assert (exit_code, file in said) == (4, True)


def test_a_damaged_record_is_copied_only_when_forced(labrig: Labrig, tmp_path: Path) -> None:
    """Without --force nothing is written; with it the copy is byte for byte the damaged record."""
    run, out = full_run(tmp_path / "runs", closed=True), tmp_path / "out"
    flip_bit(run / "frames" / "000001.png")
    refused = labrig("export", run, "--record", "--out", out)
    assert (refused.exit_code, "--force copies it as it is" in refused.err, out.exists()) == (4, True, False)
    forced = labrig("export", run, "--record", "--out", out, "--force", "--json")
    assert (forced.exit_code, forced.json()["ok"]) == (4, False)
    assert "frames/000001.png" in forced.err
    assert _contents(out) == {
        name: sha256 for name, sha256 in _contents(run).items() if name not in {".lock", ".reserve"}
    }


def test_a_copy_that_the_disk_changes_is_not_kept(tmp_path: Path) -> None:
    """Each file is read back after it is copied; one that differs ends the export with 3, and nothing is there."""
    run, out = full_run(tmp_path / "runs", closed=True), tmp_path / "copy"
    done = subprocess.run(
        [sys.executable, "-m", "tests.cli.bad_disk", "frames/000001.png",
         "export", str(run), "--record", "--out", str(out)],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, "frames/000001.png is not what was copied" in done.stderr) == (3, True)
    assert not out.exists()


@pytest.mark.parametrize("command", ["reanalyze", "report", "view", "export csv", "diff"])
def test_results_behind_a_link_are_not_read(
    command: str, whole: Path, labrig: Labrig, tmp_path: Path
) -> None:
    """A results folder that is a link is refused with exit code 4; nothing is written there."""
    results = tmp_path / "results"
    results.mkdir()

    def spoil(run: Path) -> None:
        (run / "analysis").symlink_to(results)

    exit_code, message = _call(labrig, command, _damage(whole, tmp_path, spoil), whole)
    assert exit_code == 4
    assert "analysis is a symbolic link" in message
    assert not list(results.iterdir())


@pytest.mark.parametrize(("command", "name"), [("report", "report.html"), ("view", "view.rrd")])
def test_output_replaces_a_link_and_not_its_target(
    command: str, name: str, whole: Path, labrig: Labrig, tmp_path: Path
) -> None:
    """Page and view are written in place of a link; the file behind it is unchanged."""
    run = _damage(whole, tmp_path, _link(name))
    assert _call(labrig, command, run, whole)[0] == 0
    assert not (run / name).is_symlink()
