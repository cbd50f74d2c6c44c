"""Spoilt files and hostile options: no traceback, no hang, no exit code that is not documented.

Each case spoils one kind of file that labrig reads, or the options of a command, from a seed of its own. Most run in
this process, by the reader of the file or by the command line's own function; the others start `labrig`.
"""

import contextlib
import io
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import traceback
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache, partial
from hashlib import sha256
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter
from types import FrameType
from typing import Any

import cv2
import numpy as np

from labrig.analysis.result import load_centre_lines
from labrig.campaign.campaign_file import load_campaign_file
from labrig.cli.main import run_command
from labrig.devices.drives.eds import read_eds
from labrig.devices.motion_log import read_last_motion
from labrig.devices.needle_state import NeedleState
from labrig.devices.rig_file import load_rig
from labrig.errors import LabrigError
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.insertion.scenario import load_scenario, make_problem
from labrig.experiments.registry import find_run_experiment, load_run_result
from labrig.posix import WORKER_START_METHOD
from labrig.protocol.design_file import load_design
from labrig.protocol.load import load_protocol
from labrig.protocol.specimen_file import load_specimen
from labrig.record.catalogue import find_runs
from labrig.record.check import check_run
from labrig.record.json_lines import encode_line
from labrig.record.lock import read_lock_owner
from labrig.record.notes import annotate_run
from labrig.record.reader import open_run
from labrig.vision.calibration_file import load_intrinsics, load_plane, read_creation_time
from labrig.vision.mask import load_mask
from labrig.vision.picture import read_picture
from labrig.vision.template_file import load_template
from tests.benchmarks.spoiling import (
    HOSTILE_YAML,
    Spoil,
    mixed,
    spoil_bytes,
    spoil_json,
    spoil_lines,
    spoil_text,
    spoil_yaml,
)
from tests.benchmarks.table import print_rows
from tests.cli.example_runs import SHORTENED
from tests.devices.cia402.eds_text import eds_text

ROOT = Path(__file__).parents[2]
RECORDS = ROOT / "tests" / "records"
RIG = ROOT / "calibration" / "rig-simulated.yaml"

IN_PROCESS, BY_COMMAND = 19_500, 500
SEED = 1
_LIMIT_S = 20.0
_SEALED = "sealed"
_BATCH = 25
_MEMORY_BYTES = 6 * 2**30
_FILE_BYTES = 2**29
_PNG = b"\x89PNG\r\n\x1a\n"
_GREY = np.random.default_rng(0).integers(0, 256, (60, 80), dtype=np.uint8)
_WRONG_INPUT = frozenset({0, 1, 2})
_RECORD = frozenset({0, 1, 2, 4})


class TooSlowError(BaseException):
    """A case has taken longer than the limit; no `Exception`, so that nothing swallows it."""


@dataclass
class FuzzOutcome:
    """How a case ended: the exit code, or what went wrong."""

    kind: str
    number: int
    code: int
    fault: str
    seconds: float


@dataclass(frozen=True)
class FuzzPlace:
    """Where a case puts its files, with what it draws from."""

    folder: Path
    rng: random.Random
    by_command: bool = False

    def write(self, name: str, content: bytes) -> Path:
        """Write a file and return its path."""
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        return path

    def labrig(self, *arguments: object) -> int:
        """Run a command line; return its exit code, or raise what no user should see."""
        words = [str(argument) for argument in arguments]
        return _start(words, self.folder) if self.by_command else _call(words, self.folder)


class ShownError(Exception):
    """A command showed what no user should see."""


def _call(words: Sequence[str], folder: Path) -> int:
    out, err = io.StringIO(), io.StringIO()
    before, tempfile.tempdir = (tempfile.tempdir, sys.stdin), str(folder)
    sys.stdin = io.StringIO()
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = run_command(words)
    finally:
        tempfile.tempdir, sys.stdin = before
    _require_proper(code, out.getvalue(), err.getvalue(), words, folder)
    return code


def _start(words: Sequence[str], folder: Path) -> int:
    environment = {**os.environ, "TMPDIR": str(folder), "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "labrig", *(word.replace("\0", "") for word in words)]
    try:
        done = subprocess.run(
            command,
            cwd=folder,
            env=environment,
            capture_output=True,
            timeout=_LIMIT_S,
            check=False,
            stdin=subprocess.DEVNULL,
        )
    except subprocess.TimeoutExpired as error:
        raise TooSlowError(f"{' '.join(words)[:300]}") from error
    texts = (done.stdout.decode(errors="replace"), done.stderr.decode(errors="replace"))
    _require_proper(done.returncode, *texts, words, folder)
    return done.returncode


def _require_proper(code: int, out: str, err: str, words: Sequence[str], folder: Path) -> None:
    asked = " ".join(words)[:300]
    for bug in folder.glob("labrig-bug-*.txt"):
        raise ShownError(f"{asked}\n{bug.read_text(encoding='utf-8')}")
    if "Traceback" in err or code not in {0, 1, 2, 3, 4}:
        raise ShownError(f"{asked}: exit code {code}\n{err[-2000:]}")
    # Behind an option the word is its value.
    if code != 0 and words[-1] == "--json" and not words[-2].startswith("-"):
        try:
            json.loads(out)
        except ValueError as error:
            raise ShownError(
                f"{asked}: exit code {code}, no JSON document: {out[:200]!r}; {err[-300:]}"
            ) from error


@dataclass(frozen=True)
class Kind:
    """A kind of case: how often it is tried, what it does, and the exit codes that are right."""

    name: str
    share: int
    attack: Callable[[FuzzPlace], int | None]
    codes: frozenset[int] = _WRONG_INPUT


def _file(
    name: str,
    share: int,
    files: Mapping[str, bytes],
    spoil: Spoil,
    read: Callable[[Path], object],
    codes: frozenset[int] = _WRONG_INPUT,
) -> Kind:
    """Return the kind of case that spoils the first of some files and reads it."""
    first = next(iter(files))

    def attack(place: FuzzPlace) -> None:
        for other, content in files.items():
            place.write(other, content)
        path = place.write(first, mixed(spoil)(place.rng, files[first]))
        if place.rng.random() < 0.01:
            _replace(place.rng, path)
        read(path)

    return Kind(name, share, attack, codes)


def _replace(rng: random.Random, path: Path) -> None:
    """Put something that is no regular file into a file's place, or nothing."""
    path.unlink(missing_ok=True)
    match rng.randrange(6):
        case 0:
            os.mkfifo(path)
        case 1:
            path.symlink_to("/dev/zero")
        case 2:
            path.symlink_to(path.name + "-nowhere")
        case 3:
            path.mkdir()
        case 4:
            allowed = resource.getrlimit(resource.RLIMIT_FSIZE)
            resource.setrlimit(resource.RLIMIT_FSIZE, (allowed[1], allowed[1]))
            with path.open("wb") as file:
                file.truncate(10**12)
            resource.setrlimit(resource.RLIMIT_FSIZE, allowed)


def _protocols() -> Iterator[Kind]:
    for path in sorted((ROOT / "protocols").glob("*.yaml")):
        is_campaign = path.stem.startswith("campaign-")
        yield _file(
            f"protocol {path.stem}",
            1 if is_campaign else 3,
            {path.name: path.read_bytes()},
            spoil_yaml,
            load_campaign_file if is_campaign else lambda file: load_protocol(file, PROTOCOL_MODELS),
        )


def _pictures() -> Iterator[Kind]:
    for suffix in (".png", ".jpg", ".bmp", ".tif"):
        content = cv2.imencode(suffix, _GREY)[1].tobytes()
        yield _file(f"picture {suffix}", 5, {f"picture{suffix}": content}, _spoil_header, read_picture)


def _spoil_header(rng: random.Random, content: bytes) -> bytes:
    """Spoil the beginning, where sizes stand; a PNG's checksums are redone, so that its decoder sees it."""
    spoilt = spoil_bytes(rng, content[:200]) + content[200:]
    return _redo_checksums(spoilt) if spoilt.startswith(_PNG) and rng.random() < 0.8 else spoilt


def _redo_checksums(png: bytes) -> bytes:
    content, position = bytearray(png), len(_PNG)
    while position + 12 <= len(content):
        end = position + 8 + int.from_bytes(content[position : position + 4], "big")
        content[end : end + 4] = zlib.crc32(content[position + 4 : end]).to_bytes(4, "big")
        position = end + 4
    return bytes(content)


def _read_mask(path: Path) -> None:
    mask = load_mask(path)
    for name in ("a.png", "000012.png"):
        mask.find_masked(name, _GREY)


def _read_state(path: Path) -> None:
    state = NeedleState(path).state
    assert isinstance(state.doubt, str)


_SPECIMEN = b"""name: A1
gelatin_percent: 10
batch: B7
mixed_on: 2026-11-20T08:30+01:00
cast_on: 2026-11-20T09:30+01:00
cured_for_h: 24
refractive_index: 1.35
refractive_index_sd: 0.002
"""
_SCENARIO = b"""needle:
  radius_mm: 30
  diameter_mm: 1.2
target:
  position_mm: [0, 5, 40]
  tolerance_mm: 1
obstacles:
- position_mm: [0, 2, 20]
  radius_mm: 2
planar: true
clearance_mm: 0.5
max_arcs: 3
max_length_mm: 80
"""
_STATE = json.dumps(
    {
        "kind": "labrig-rig-state",
        "schema_version": 1,
        "needle_in_tissue": False,
        "since_run": None,
        "referenced": ["rotation"],
        "note": "",
        "roll_zero": {"needle_id": "N1", "zero_rad": 0.1, "sd_rad": 0.01, "run": "r"},
    }
).encode()
_MASK = b'{"*": [[[0, 0], [30, 0], [30, 20]]], "000012.png": [[[5, 5], [9, 5], [9, 9]]]}'
_LOG = b"".join(encode_line({"kind": kind, "axis": "linear", "position": 1.5}) for kind in ("start", "end"))


def _simple_files() -> Iterator[Kind]:
    calibration = ROOT / "calibration"
    lens = (calibration / "simulated-intrinsics.json").read_bytes()
    plane = (calibration / "simulated-plane.json").read_bytes()
    tip = {f"tip{end}": (calibration / f"simulated-tip{end}").read_bytes() for end in (".json", ".png")}
    rig = {path.name: path.read_bytes() for path in sorted(calibration.iterdir()) if path.is_file()}
    del rig["rig-simulated.yaml"]
    rig = {"rig-simulated.yaml": RIG.read_bytes(), **rig}
    design = RECORDS / "design" / "analysis" / "001" / "design.json"
    npz = RECORDS / "import" / "analysis" / "001" / "centre_lines.npz"
    known = load_intrinsics(calibration / "simulated-intrinsics.json")
    yield _file("rig", 12, rig, spoil_yaml, load_rig)
    yield _file("design file", 4, {"design.json": design.read_bytes()}, spoil_json, load_design)
    yield _file(
        "specimen file",
        3,
        {"A1.yaml": _SPECIMEN},
        spoil_yaml,
        lambda path: load_specimen("A1", [path.parent]),
    )
    yield _file(
        "scenario", 3, {"s.yaml": _SCENARIO}, spoil_yaml, lambda path: make_problem(load_scenario(path))
    )
    yield _file(
        "intrinsics",
        6,
        {"i.json": lens},
        spoil_json,
        lambda path: (read_creation_time(path), load_intrinsics(path)),
    )
    yield _file("plane map", 6, {"p.json": plane}, spoil_json, lambda path: load_plane(path, known))
    yield _file("polygons", 6, {"mask.json": _MASK}, spoil_json, _read_mask)
    yield _file("mask", 2, {"mask.png": cv2.imencode(".png", _GREY)[1].tobytes()}, _spoil_header, _read_mask)
    yield _file("template", 3, tip, spoil_json, load_template)
    yield _file(
        "centre lines",
        4,
        {"centre_lines.npz": npz.read_bytes()},
        spoil_bytes,
        lambda path: load_centre_lines(path.parent),
        frozenset({0, 4}),
    )
    yield _file("state", 4, {"state.json": _STATE}, spoil_json, _read_state)
    yield _file(
        "motion log",
        2,
        {"state.json.motions.jsonl": _LOG},
        spoil_lines,
        lambda path: read_last_motion(path.with_name("state.json")),
    )
    yield _file(
        "EDS",
        4,
        {"drive.eds": eds_text().encode()},
        spoil_text,
        lambda path: read_eds(path, path.parent),
    )
    yield _file(
        "lock", 2, {".lock": b'{"doing": "labrig run", "pid": 1, "host": "x"}'}, spoil_json, read_lock_owner
    )


@cache
def _record(name: str) -> Mapping[str, bytes]:
    """Return the files of a kept record, or of a run that was just made and sealed."""
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        run = RECORDS / name
        if name == _SEALED:
            scale = ("--px-per-mm", "5", "--origin-px", "1", "2", "--insertion", "right")
            run_command(["import", str(RECORDS / "import" / "frames"), *scale, "--runs-dir", folder])
            (run,) = (path for path in Path(folder).iterdir() if path.is_dir())
            run_command(["runs", "annotate", str(run), "--note", "cloudy"])
        return {
            path.relative_to(run).as_posix(): path.read_bytes()
            for path in sorted(run.rglob("*"))
            if path.is_file()
        }


_NOTES = b"".join(
    encode_line({**remark, "by": "x", "at": "2026-01-01T00:00:00+00:00"})
    for remark in (
        {"kind": "tag", "tag": "pilot"},
        {"kind": "note", "note": 1, "revision": 1, "text": "cloudy"},
        {"kind": "verdict", "verdict": "bad", "reason": "bubble"},
    )
)
_SPOILS: Mapping[str, Spoil] = {
    ".jsonl": spoil_lines,
    ".json": spoil_json,
    ".yaml": spoil_yaml,
    ".png": _spoil_header,
}


def _put_record(place: FuzzPlace) -> Path:
    """Write a record of which a file or two are spoilt, mostly with the hashes redone; return its folder."""
    rng = place.rng
    name = rng.choice([_SEALED, *sorted(path.name for path in RECORDS.iterdir())])
    files = {"notes.jsonl": _NOTES, **_record(name)}
    spoilt = rng.sample(sorted(files), rng.choice((1, 1, 2)))
    # A run may have thousands of pictures; it has one manifest.
    if rng.random() < 0.5:
        spoilt = [rng.choice(sorted(file for file in files if not file.startswith("frames/")))]
    for file in spoilt:
        files[file] = mixed(_SPOILS.get(Path(file).suffix, spoil_text))(rng, files[file])
    if rng.random() < 0.7:
        files = _reseal(files)
    for file, content in files.items():
        place.write(f"runs/{name}/{file}", content)
    run = place.folder / "runs" / name
    if rng.random() < 0.02 and "analysis" in {path.parts[0] for path in map(Path, files)}:
        shutil.copytree(
            run / "analysis" / "001", run / "analysis" / rng.choice(("001.bak", "²", "004", "-1"))
        )
    if rng.random() < 0.08:
        _replace(rng, run / spoilt[0])
    return run


def _reseal(files: Mapping[str, bytes]) -> dict[str, bytes]:
    """Return the files of a record with the hashes that fit them, as far as they can still be read."""
    sums = {file: sha256(content).hexdigest() for file, content in files.items()}
    sealed = dict(files)
    with contextlib.suppress(ValueError, KeyError, TypeError, AttributeError, RecursionError):
        listed = [line[66:] for line in files["SHA256SUMS"].decode().splitlines()]
        sealed["SHA256SUMS"] = b"".join(f"{sums[file]}  {file}\n".encode() for file in listed if file in sums)
    return sealed


def _read_record(place: FuzzPlace) -> int:
    """Read everything of a spoilt record that Python's interface gives."""
    path = _put_record(place)
    run = None
    code = 0
    reads: Sequence[Callable[[Any], object]] = (
        lambda run: run.states,
        lambda run: run.events,
        lambda run: run.trials,
        lambda run: [*run.pictures],
        lambda run: run.frame_lines,
        lambda run: run.annotations,
        lambda run: run.sessions,
        lambda run: run.protocol,
        lambda run: find_run_experiment(run).result_model,
        load_run_result,
        lambda run: check_run(run.path),
        lambda run: annotate_run(run.path, note="x", by="x", at=_NOW),
    )
    try:
        run = open_run(path)
    except LabrigError as error:
        return error.exit_code
    for read in reads:
        try:
            read(run)
        except LabrigError as error:
            code = max(code, error.exit_code)
    return code


_NOW = datetime(2026, 1, 1, tzinfo=UTC)
_QUICK = (
    ("runs", "check", "RUN"),
    ("runs", "--runs-dir", "RUNS"),
    ("runs", "--runs-dir", "RUNS", "--where", "gelatin_percent=13 or trials_done>0", "--sort", "duration_s"),
    ("runs", "show", "RUN"),
    ("runs", "annotate", "RUN", "--note", "x"),
    ("runs", "annotate", "RUN", "--tag", "x"),
    ("runs", "annotate", "RUN", "--verdict", "bad"),
    ("resume", "RUN", "--rig", "RIG"),
    ("calibrate", "adopt", "RUN", "--rig", "RIG"),
    ("design", "--from-run", "RUN", "--grid-points", "3"),
    ("devices", "withdraw", "--run", "RUN", "--rig", "RIG", "--yes"),
)
_SLOW = (
    ("report", "RUN"),
    ("report", "RUN"),
    ("view", "RUN", "--no-open"),
    ("reanalyze", "RUN"),
    ("replay", "RUN"),
    ("calibrate", "template", "RUN", "--out", "t.png"),
)


_EXPORTS = (
    ("export", "RUN", "--format", "record", "--out", "out"),
    ("export", "RUN", "--format", "csv", "--out", "out"),
    ("export", "RUN", "--format", "parquet", "--format", "matlab", "--out", "out"),
)


def _show_record(commands: Sequence[Sequence[str]]) -> Callable[[FuzzPlace], int]:
    """Return an attack that gives a spoilt record to a command."""

    def attack(place: FuzzPlace) -> int:
        run = _put_record(place)
        words = list(place.rng.choice(commands))
        if "RIG" in words:
            _put_rig(place)
        names = {
            "RUN": run,
            "RUNS": run.parent,
            "GOOD": RECORDS / "import",
            "RIG": place.folder / "rig" / RIG.name,
        }
        as_json = ("--json",) if place.rng.random() < 0.7 else ()
        return place.labrig(*(names.get(word, word) for word in words), *as_json)

    return attack


def _put_rig(place: FuzzPlace) -> None:
    for path in RIG.parent.iterdir():
        place.write(f"rig/{path.name}", path.read_bytes())


def _spoil_index(place: FuzzPlace) -> int:
    """Search runs by an index that is spoilt."""
    for name in ("import", "design"):
        for file, content in _record(name).items():
            if not file.endswith(".png"):
                place.write(f"runs/{name}/{file}", content)
    find_runs(place.folder / "runs", "trials_done>=0")
    index = place.folder / "runs" / ".catalogue.sqlite3"
    index.write_bytes(spoil_bytes(place.rng, index.read_bytes()))
    if place.rng.random() < 0.05:
        _replace(place.rng, index)
    assert len(find_runs(place.folder / "runs", "trials_done>=0")) <= 2
    return 0


_SHORT = tuple(word for setting in SHORTENED["steerability"] for word in ("--set", setting))
_LINES = [
    line.split()
    for line in """\
run PROTOCOLS/design.yaml --runs-dir new --set grid_points=3 --seed 1 --run-name r
check PROTOCOLS/steerability.yaml --rig RIG --seed 1 --set insertions_per_specimen=2
check PROTOCOLS/insertion.yaml --rig RIG --set target.position_mm=[0,2,20]
plan s.yaml --figure plan.svg
import pictures --px-per-mm 5 --origin-px 1 2 --insertion right --runs-dir new --title t
measure curvature picture.png --px-per-mm 5 --origin-px 1 2 --insertion right
measure tip picture.png --template RIGS/simulated-tip.png --near-px 3 4 --px-per-mm 5 --origin-px \
 1 2 --insertion right --heading-deg 3
calibrate intrinsics picture.png --board 9x6 --square-mm 2  --out i.json
calibrate intrinsics picture.png --board 9x6 --square-mm 2 --charuco DICT_5X5_100 --marker-mm 1
calibrate intrinsics picture.png --board 6x6 --square-mm 2 --tag-spacing 0.3
calibrate plane picture.png --origin-px 3 4 --insertion up --px-per-mm 10
calibrate plane picture.png --origin-px 3 4 --insertion up --intrinsics RIGS/simulated-intrinsics.json --distance-mm 185
calibrate template picture.png --tip-px 30 30 --heading-deg 0 --out t.png
runs --runs-dir runs --where tag=x --sort started --reverse
runs tag runs/import --tag x --by me
runs note runs/import text --by me --revise 1
runs verdict runs/import bad --reason why
runs diff runs/import runs/design
export runs/import --format csv --out out
reanalyze runs/import --set analysis.x=1 --mask m.json
devices home --rig RIG --axis linear --needle none --method 1 --current-ma 0 --yes
devices jog --rig RIG --axis linear --distance 1 --speed 1 --current-ma 0 --yes
devices withdraw --rig RIG --run runs/insertion --insertion-mm 3 --rotation-rad 0 --linear-mm 1
devices stop --rig RIG
devices simulate --interface virtual --nodes 1,2 --port 1 --bitrate 1
""".splitlines()
]
_WORDS = (
    "", " ", "nan", "inf", "-1", "0", "1e308", "1e-308", "-0", "9" * 25, "²", "٣", "é\udce9", "a" * 5000,
    "\x1b[31m", "--", "-", "fifo", "folder", "zero", "dangling", "nowhere/x", "empty", "text.txt",
    "picture.png", "10²5.png", "latin\udce9.png", "reference://x", "memory://x", "zip::memory://x",
    "http://127.0.0.1:9/x", "file:///nowhere", "s3://x", "nowhere://x", "x=y", "rig.x=1", "=", "a.b.c=1",
    "specimens=[", "999999999x999999999", "3x3", "last", "..", ".", "%s", "{}", "a,b", "0,0", "999", "(((((",
    "x=1 and", "not", "1" + " or 1" * 500, "(" * 3000, "s.yaml", "RIG", "runs/import", "runs", "pictures",
)  # fmt: skip


def _spoil_options(place: FuzzPlace) -> int:
    """Give a command hostile options."""
    rng = place.rng
    _put_rig(place)
    place.write("s.yaml", _SCENARIO)
    place.write("m.json", _MASK)
    place.write("text.txt", b"text")
    place.write("empty", b"")
    picture = cv2.imencode(".png", _GREY)[1].tobytes()
    for name in (
        "picture.png",
        "10²5.png",
        "latin\udce9.png",
        "pictures/1.png",
        "pictures/latin\udce9.png",
        "pictures/²5.png",
    ):
        place.write(name, picture)
    os.mkfifo(place.folder / "fifo")
    (place.folder / "folder").mkdir()
    (place.folder / "zero").symlink_to("/dev/zero")
    (place.folder / "dangling").symlink_to("nowhere")
    for name in ("import", "design"):
        for file, content in _record(name).items():
            place.write(f"runs/{name}/{file}", content)
    words = list(rng.choice(_LINES))
    for _ in range(rng.choice((1, 1, 2, 4))):
        number = rng.randrange(1, len(words))
        match rng.randrange(8):
            case 0:
                del words[number]
            case 1:
                words.insert(number, rng.choice(_WORDS))
            case 2 if "=" in words[number]:
                words[number] = f"{words[number].partition('=')[0]}={rng.choice(HOSTILE_YAML)}"
            case _:
                words[number] = rng.choice(_WORDS)
        if len(words) < 2:
            break
    known = {
        "PROTOCOLS": str(ROOT / "protocols"),
        "RIGS": str(place.folder / "rig"),
        "RIG": str(place.folder / "rig" / RIG.name),
    }
    first = ("PROTOCOLS", "RIGS", "RIG")
    shown = [
        next((word.replace(name, known[name], 1) for name in first if word.startswith(name)), word)
        for word in words
    ]
    return place.labrig(*shown, *(("--json",) if rng.random() < 0.5 else ()))


def list_kinds() -> list[Kind]:
    """Return every kind of case that runs in this process."""
    return [
        *_protocols(),
        *_pictures(),
        *_simple_files(),
        Kind("record, read", 30, _read_record, _RECORD),
        Kind("record, quick commands", 16, _show_record(_QUICK), _RECORD),
        Kind("record, other commands", 6, _show_record(_SLOW), _RECORD),
        Kind("record, export", 4, _show_record(_EXPORTS), _RECORD | {3}),
        Kind("index of runs", 3, _spoil_index),
        Kind("options", 20, _spoil_options, _RECORD | {3}),
    ]


def _list_commands() -> list[Kind]:
    return [
        Kind("labrig, record", 3, _show_record((*_QUICK, *_SLOW, *_EXPORTS)), _RECORD | {3}),
        Kind("labrig, options", 2, _spoil_options, _RECORD | {3}),
    ]


def run_case(kind: Kind, number: int, folder: Path, *, by_command: bool = False) -> FuzzOutcome:
    """Run a case in a folder of its own, which is removed."""
    place = FuzzPlace(
        Path(tempfile.mkdtemp(dir=folder)) / "here", random.Random(f"{SEED} {kind.name} {number}"), by_command
    )
    place.folder.mkdir()
    before = Path.cwd()
    os.chdir(place.folder)
    code, fault = 0, ""
    started = perf_counter()
    try:
        signal.signal(signal.SIGALRM, _interrupt)
        signal.setitimer(signal.ITIMER_REAL, _LIMIT_S)
        code = kind.attack(place) or 0
    except LabrigError as error:
        code = error.exit_code
    except TooSlowError as error:
        fault = "".join(traceback.format_exception(error))
    except Exception as error:  # noqa: BLE001 - whatever it is, it is what is looked for
        fault = str(error) if isinstance(error, ShownError) else "".join(traceback.format_exception(error))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        seconds = perf_counter() - started
        os.chdir(before)
        shutil.rmtree(place.folder.parent, ignore_errors=True)
    if not fault and code not in kind.codes:
        fault = f"exit code {code}, expected one of {sorted(kind.codes)}"
    return FuzzOutcome(kind.name, number, code, fault, seconds)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise TooSlowError(f"more than {_LIMIT_S:g} s")


def share_out(kinds: Sequence[Kind], cases: int) -> list[tuple[int, int]]:
    """Return the place of the kind in the list, and the number, of each case."""
    whole = sum(kind.share for kind in kinds)
    ends = [cases * sum(kind.share for kind in kinds[:place]) // whole for place in range(len(kinds) + 1)]
    return [(place, number) for place in range(len(kinds)) for number in range(ends[place + 1] - ends[place])]


def _run_batch(by_command: bool, cases: Sequence[tuple[int, int]]) -> list[FuzzOutcome]:
    """Run cases in a worker process, whose memory is bounded."""
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_FSIZE, (_FILE_BYTES, resource.RLIM_INFINITY))
    cv2.setNumThreads(1)
    kinds = _list_commands() if by_command else list_kinds()
    with tempfile.TemporaryDirectory(dir=_find_fast_folder()) as folder:
        return [run_case(kinds[kind], number, Path(folder), by_command=by_command) for kind, number in cases]


def _find_fast_folder() -> str | None:
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


def _run_all(cases: int, *, by_command: bool) -> Iterator[FuzzOutcome]:
    kinds = _list_commands() if by_command else list_kinds()
    numbered = share_out(kinds, cases)
    random.Random(0).shuffle(numbered)
    batches = [numbered[start : start + _BATCH] for start in range(0, len(numbered), _BATCH)]
    work, context = partial(_run_batch, by_command), get_context(WORKER_START_METHOD)
    with ProcessPoolExecutor(max_workers=2, mp_context=context) as pool:
        outcomes = [outcome for batch in pool.map(work, batches) for outcome in batch]
    # What was slow beside others, and on a machine with other work, is tried once more alone.
    with ProcessPoolExecutor(max_workers=1, mp_context=context) as pool:
        places = {kind.name: place for place, kind in enumerate(kinds)}
        for outcome in outcomes:
            slow = TooSlowError.__name__ in outcome.fault
            yield pool.submit(work, [(places[outcome.kind], outcome.number)]).result()[0] if slow else outcome


def print_table(in_process: int = IN_PROCESS, by_command: int = BY_COMMAND) -> None:
    """Print how the cases of each kind ended; end with an error if one showed a fault."""
    outcomes = [*_run_all(in_process, by_command=False), *_run_all(by_command, by_command=True)]
    kinds = dict.fromkeys(outcome.kind for outcome in outcomes)
    rows = [_count(kind, [outcome for outcome in outcomes if outcome.kind == kind]) for kind in kinds]
    print_rows(
        ("kind", "cases", "exit 0", "1", "2", "3", "4", "faults", "slowest s"),
        [*rows, _count("all", outcomes)],
    )
    faults = [outcome for outcome in outcomes if outcome.fault]
    for outcome in faults:
        print(
            f"\n{outcome.kind} {outcome.number}, {outcome.seconds:.1f} s:\n{outcome.fault}", file=sys.stderr
        )
    if faults:
        raise RuntimeError(f"{len(faults)} of {len(outcomes)} cases showed a fault")


def _count(name: str, outcomes: Sequence[FuzzOutcome]) -> tuple[object, ...]:
    """Return the row of a table: cases, those of each exit code, faults, and the slowest."""
    codes = Counter(outcome.code for outcome in outcomes if not outcome.fault)
    faults = sum(bool(outcome.fault) for outcome in outcomes)
    slowest = max((outcome.seconds for outcome in outcomes), default=0.0)
    return (name, len(outcomes), *(codes[code] for code in range(5)), faults, f"{slowest:.1f}")
