"""Spoilt files and hostile options: no traceback, and no exit code that is not documented."""

import random
import re
import shutil
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from labrig.analysis.result import load_centre_lines
from labrig.campaign.campaign_file import load_campaign_file
from labrig.devices.drives.eds import read_eds
from labrig.devices.needle_state import NeedleState
from labrig.devices.rig_file import load_rig
from labrig.errors import LabrigError
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.library.scenario import load_scenario, make_problem
from labrig.protocol.design_file import load_design
from labrig.protocol.load import load_protocol
from labrig.protocol.specimen_file import load_specimen
from labrig.record.lock import read_lock_owner
from labrig.vision.calibration_file import load_intrinsics, load_plane
from labrig.vision.picture import load_mask, read_picture
from labrig.vision.template import load_template
from tests.cli.conftest import RIG, ROOT, Done, Labrig, labrig

HOSTILE = (
    "", "null", "~", "true", "-1", "0", "1.5", "1e308", "1e999", "NaN", ".nan", "-Infinity", "9" * 400, '"x"', '""',
    '"\\ud800"', '"\\u0000"', '"../../x"', "<script>", f'"{"é" * 3000}"', "[]", "{}", "[null]", "{a: 1}", "[1, 2, 3]",
    "[" * 70 + "]" * 70, "[" * 20_000, "'", "&a [*a]", "!!python/object x", "|", "- - -", "? a", "a: b: c", "---",
    "2026-02-30", "1:30", "0o777", "<<: *a", "/dev/zero", "\ufeff", "²", "\t", "\x1b[2J",
)  # fmt: skip
_BYTES = (b"", b"\0", b"\xff\xfe", b"\xed\xa0\x80", b"\r", b"{" * 5000, b'"', b"\\", b",", b"-")
_WORD = re.compile(r'"(?:[^"\\]|\\.)*"|[\w.+-]+')


def spoil(rng: random.Random, content: bytes) -> bytes:
    """Return the content with a few places changed; a text mostly by its values, so that readers get far into it."""
    for _ in range(rng.choice((1, 1, 1, 3))):
        try:
            text = content.decode("utf-8")
        except UnicodeDecodeError:
            text = ""
        spoilt = _spoil_text(rng, text).encode("utf-8", "surrogatepass")
        content = spoilt if text and rng.random() < 0.7 else _spoil_bytes(rng, content)
    return content


def _spoil_text(rng: random.Random, text: str) -> str:
    """Replace a word, or remove, double or add a line."""
    lines = text.split("\n")
    place = rng.randrange(len(lines))
    words = list(_WORD.finditer(lines[place]))
    if words and rng.random() < 0.7:
        word = rng.choice(words)
        lines[place] = f"{lines[place][: word.start()]}{rng.choice(HOSTILE)}{lines[place][word.end() :]}"
    else:
        lines[place : place + 1] = rng.choice(([], [lines[place]] * 2, [lines[place], rng.choice(HOSTILE)]))
    return "\n".join(lines)


def _spoil_bytes(rng: random.Random, content: bytes) -> bytes:
    """Flip a bit, cut the end off, or replace a stretch."""
    start = rng.randrange(len(content) + 1)
    end = min(len(content), start + rng.choice((0, 1, 4, 100, 10**9)))
    if rng.random() < 0.4 and start < len(content):
        return content[:start] + bytes([content[start] ^ 1 << rng.randrange(8)]) + content[start + 1 :]
    return content[:start] + rng.choice(_BYTES) + content[end:]


__all__ = ["labrig"]
pytestmark = pytest.mark.slow

RECORDS = ROOT / "tests" / "records"
CALIBRATION = RIG.parent
SEEDS = st.integers(0, 2**32 - 1)
MANY = settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
_GREY = np.random.default_rng(0).integers(0, 256, (60, 80), dtype=np.uint8)
_SPECIMEN = b"name: A1\ngelatin_percent: 10\nbatch: B7\ncured_for_h: 24\n"
_SCENARIO = b"""needle: {radius_mm: 30, diameter_mm: 1.2}
target: {position_mm: [0, 5, 40], tolerance_mm: 1}
obstacles: [{position_mm: [0, 2, 20], radius_mm: 2}]
planar: true
clearance_mm: 0.5
max_length_mm: 80
"""
_STATE = b"""{"kind": "labrig-rig-state", "schema_version": 1, "needle_in_tissue": false, "since_run": null,
"referenced": ["rotation"], "note": "", "roll_zero": {"needle_id": "N1", "zero_rad": 0.1, "sd_rad": 0.01, "run": "r"}}
"""


Read = Callable[[Path], object]
BESIDE = {path.name: path.read_bytes() for path in CALIBRATION.iterdir() if path.is_file()}


def _list_kinds() -> Iterator[tuple[str, bytes, Read]]:
    """Yield each kind of file that labrig reads: its name, its content and its reader."""
    for path in sorted((ROOT / "protocols").glob("*.yaml")):
        campaign = path.stem.startswith("campaign-")
        yield path.name, path.read_bytes(), load_campaign_file if campaign else _load_protocol
    for suffix in (".png", ".jpg", ".bmp", ".tif"):
        yield f"picture{suffix}", cv2.imencode(suffix, _GREY)[1].tobytes(), read_picture
    yield "mask.png", cv2.imencode(".png", _GREY)[1].tobytes(), load_mask
    yield "A1.yaml", _SPECIMEN, lambda path: load_specimen("A1", [path.parent])
    yield "scenario.yaml", _SCENARIO, lambda path: make_problem(load_scenario(path))
    yield "state.json", _STATE, lambda path: NeedleState(path).state
    yield ".lock", b'{"doing": "labrig run", "pid": 1, "host": "x"}', read_lock_owner
    lens = CALIBRATION / "simulated-intrinsics.json"
    readers: tuple[tuple[Path, Read], ...] = (
        (RIG, load_rig),
        (lens, load_intrinsics),
        (CALIBRATION / "simulated-plane.json", lambda path: load_plane(path, load_intrinsics(lens))),
        (CALIBRATION / "simulated-tip.json", load_template),
        (RECORDS / "design/analysis/001/design.json", load_design),
        (RECORDS / "import/analysis/001/centre_lines.npz", lambda path: load_centre_lines(path.parent)),
        (ROOT / "labrig/devices/drives/epos2.eds", lambda path: read_eds(path, path.parent)),
    )
    yield from ((path.name, path.read_bytes(), read) for path, read in readers)


def _load_protocol(path: Path) -> object:
    return load_protocol(path, PROTOCOL_MODELS)


@pytest.mark.parametrize(
    ("name", "content", "read"), [pytest.param(*kind, id=kind[0]) for kind in _list_kinds()]
)
@MANY
@given(seed=SEEDS)
def test_a_spoilt_file_is_read_or_refused(
    name: str, content: bytes, read: Read, seed: int, tmp_path: Path
) -> None:
    """Nothing but a refusal, as wrong input or as damage, comes out of its reader."""
    for other, beside in BESIDE.items():
        (tmp_path / other).write_bytes(beside)
    (tmp_path / name).write_bytes(spoil(random.Random(seed), content))
    try:
        read(tmp_path / name)
    except LabrigError as error:
        assert error.exit_code in {1, 2, 4}  # noqa: PT017 - another error is a failure


@pytest.mark.parametrize(
    "words",
    [
        "runs check RUN", "runs --runs-dir RUNS --where trials_done>0", "runs show RUN",
        "runs annotate RUN --tag x", "resume RUN --rig RIG", "calibrate adopt RUN --rig RIG",
        "devices withdraw --run RUN --rig RIG", "report RUN", "reanalyze RUN", "replay RUN",
        "compare RUN --out OUT", "export RUN --format csv --out OUT", "export RUN --format record --out OUT",
    ],
)  # fmt: skip
@settings(MANY, max_examples=8)
@given(seed=SEEDS)
def test_a_spoilt_record_is_read_or_refused(words: str, seed: int, labrig: Labrig, tmp_path: Path) -> None:
    """Whichever file was spoilt, and also if its checksum was made to fit."""
    rng, run, sums = random.Random(seed), tmp_path / "runs" / "run", tmp_path / "runs" / "run" / "SHA256SUMS"
    shutil.rmtree(tmp_path / "runs", ignore_errors=True)
    shutil.copytree(RECORDS / rng.choice(("import", "roll-zero", "steerability")), run)
    path = rng.choice([file for file in sorted(run.rglob("*")) if file.is_file() and file.suffix != ".png"])
    before = sha256(path.read_bytes()).hexdigest()
    path.write_bytes(spoil(rng, path.read_bytes()))
    if rng.random() < 0.7 and path != sums:
        sums.write_text(sums.read_text().replace(before, sha256(path.read_bytes()).hexdigest()))
    shutil.copytree(CALIBRATION, tmp_path / "calibration", dirs_exist_ok=True)
    named = {
        "RUN": run, "RUNS": run.parent, "OUT": tmp_path / f"out-{seed}", "RIG": tmp_path / "calibration" / RIG.name,
    }  # fmt: skip
    _require_proper(labrig(*(named.get(word, word) for word in words.split())), (words, path.name))


@pytest.mark.parametrize(
    "line",
    [
        "check protocols/design.yaml --set grid_points=3 --seed 1",
        "check protocols/steerability.yaml --rig RIG --seed 1 --set insertions_per_specimen=2",
        "plan s.yaml --figure OUT/plan.svg",
        "import pictures --px-per-mm 5 --origin-px 1 2 --insertion right --runs-dir OUT",
        "measure curvature picture.png --px-per-mm 5 --origin-px 1 2 --insertion right",
        "calibrate intrinsics picture.png --board 9x6 --square-mm 2 --out OUT/i.json",
        "calibrate plane picture.png --origin-px 3 4 --insertion up --px-per-mm 10",
        "calibrate template picture.png --tip-px 30 30 --heading-deg 0 --out OUT/t.png",
        "runs --runs-dir runs --where tag=x",
        "export run --format csv --out OUT/x",
        "reanalyze run --set analysis.x=1",
        "devices jog --rig RIG --axis linear --distance 1 --speed 1 --current-ma 0",
    ],
)
@settings(MANY, max_examples=8)
@given(seed=SEEDS)
def test_hostile_options_are_refused(line: str, seed: int, labrig: Labrig, tmp_path: Path) -> None:
    """Each word but the command's own may be missing, doubled, or be something else."""
    rng, words = random.Random(seed), line.split()
    (tmp_path / "picture.png").write_bytes(cv2.imencode(".png", _GREY)[1].tobytes())
    (tmp_path / "s.yaml").write_bytes(_SCENARIO)
    for _ in range(rng.choice((1, 1, 2, 4))):
        place = rng.randrange(1, len(words) + 1)
        other = rng.choice((*HOSTILE, "--", "-", "last", "..", "nowhere/x", "x=y", "(" * 3000, "picture.png"))
        words[place : place + rng.choice((0, 1))] = [other] * (rng.random() < 0.9)
    named = {"RIG": str(RIG)} | {name: str(tmp_path / name) for name in ("picture.png", "s.yaml")}
    shown = [named.get(word, word.replace("OUT", str(tmp_path / f"out-{seed}"))) for word in words]
    _require_proper(labrig(*shown), shown)


def _require_proper(done: Done, told: object) -> None:
    assert (done.exit_code in {0, 1, 2, 3, 4}, "Traceback" in done.err) == (True, False), (told, done)
