"""What commands refuse: the line, its exit code, and words of its error or hint. No file is written or replaced."""

import json
import shlex
import shutil
from pathlib import Path

import pytest

from tests.cli.conftest import RIG, ROOT, SWEEP, Labrig

KEPT = ROOT / "tests" / "records" / "steerability"
BROKEN = {
    "tab": "experiment: steerability\nneedle:\n\tneedle_id: N1\n",
    "bracket": "experiment: steerability\nspecimens: [\n",
    "empty": "",
    "list": "- experiment: steerability\n",
    "unknown": "schema_version: 1\nexperiment: steerabilty\n",
    "tag": "experiment: !!python/object/apply:os.system ['true']\n",
    "misspelt": SWEEP.read_text(encoding="utf-8").replace("hole_spacing_mm:", "hole_spacing:"),
}
DESIGNS = {
    "clearance_mm=30": "less than or equal to 1",
    "clearance_mm=0": "greater than 0",
    "clearance_mm=0.3": "slip out of its socket",
    "radius_mm=7": "cuts the socket's lips through",
    "radius_mm=200": "no inclination gives",
    "tube.inner_diameter_mm=1.3": "must be below outer_diameter_mm, 1.2",
    "tube.inner_diameter_mm=0.05": "inner_diameter_mm is 0.05, must be greater than or equal to 0.1",
    "tube.link_length_mm=0.5": "at least 0.928 mm",
    "tolerances.clearance_mm=3": "less than or equal to 0.05",
    "tolerances={clearance_mm: 0.05, cut_deg: 10}": "might not turn at all",
    "measured.radius_mm=300": "no clearance gives",
    "measured.beta_cut_deg=44": "cutting inclination is 44 degrees",
    "grid_points=2": "grid_points is 2",
}
TIP = "measure tip run/frames/000003.png --px-per-mm 10 --origin-px 0 0 --insertion right --template"
REACH = f"campaign {ROOT}/protocols/campaign-reach.yaml"
PLANE = "calibrate plane run/frames/000003.png --origin-px 3 4 --insertion right"

ROWS: list[tuple[str, int, str]] = [
    # files
    *((f"run {name}.yaml --rig {RIG}", 2, f"{name}.yaml") for name in BROKEN if name != "misspelt"),
    (f"run misspelt.yaml --rig {RIG}", 2, "did you mean hole_spacing_mm?"),
    ("run nowhere.yaml", 2, "nowhere.yaml"),
    ("run notes.md", 2, "notes.md"),
    ("run steerability", 2, "labrig init FOLDER"),
    (f"check {RIG}", 2, "this is a rig file, expected a protocol"),
    (f"check {SWEEP} --rig {SWEEP}", 2, "this is a protocol, expected a rig file"),
    (f"run {SWEEP} --rig {RIG} --set rig.recording.least_free_mb=1e6 --set insertions_per_specimen=1", 3, "MB"),
    ("measure curvature text.png --px-per-mm 5 --origin-px 10 10 --insertion right", 2, "text.png"),
    ("calibrate intrinsics a.png --board 9x6 --square-mm 25 --out taken.json", 2, "taken.json exists"),
    ("calibrate intrinsics a.png --board 999999999x999999999 --square-mm 2", 2, "from 3x3 to 99x99"),
    ("import empty --px-per-mm 5 --origin-px 0 0", 2, "empty"),
    # options
    ("plan --figur x", 2, "see: labrig plan --help"),
    ("runs chek", 2, "see: labrig runs --help"),
    ("rusn", 2, "see: labrig --help"),
    ("runs --no-such-option", 2, "No such option"),
    ("manual run-formt", 2, "run-format"),
    (f"devices jog --axis linear --distance nan --rig {RIG}", 2, "--distance is nan"),
    ("design --radius-mm 1e999", 2, "--radius-mm is inf"),
    ("measure tip a.png --template t.png --near-px 3 -inf", 2, "--near-px is -inf"),
    ("measure curvature x.png --origin-px inf 1", 2, "--origin-px is inf"),
    # designs
    ("design --clearance-mm 30", 2, "give a value from 0.001"),
    ("design --clearance-mm 0", 2, "laser clearance is 0 mm"),
    ("design --radius-mm 0.03", 2, "give a value from 3.82"),
    ("design --radius-mm 7", 2, "cuts the socket's lips through"),
    *(
        (f"run {ROOT}/protocols/design.yaml --set '{setting}'", 2, words)
        for setting, words in DESIGNS.items()
    ),
    (f"run {ROOT}/protocols/design.yaml --rig {RIG}", 2, "moves no rig"),
    (f"run {ROOT}/protocols/design.yaml --set rig.world.noise_sd=0", 2, "moves no rig"),
    # runs
    ("export run --out x", 2, "--format"),
    ("export run --format record --format csv --out x", 2, "record"),
    ("export run --format x", 2, "x"),
    ("export run --format film --out x", 2, "film"),
    ("reanalyze", 2, "--where"),
    ("reanalyze run --where tag=pilot", 2, "--where"),
    ("reanalyze --where needle=none --runs-dir .", 2, "needle"),
    ("reanalyze run --set analyis.window_start_mm=5", 2, "only analysis.* can"),
    ("reanalyze run --set analysis.window_strt_mm=5", 2, "unknown key window_strt_mm"),
    ("runs --runs-dir . --where gelatin_percent", 2, "character"),
    ("runs --runs-dir . --where gelatine_percent=13", 2, "character"),
    ("runs --runs-dir . --where 'exit_status=success and'", 2, "character"),
    ("runs annotate run --untag other", 2, "other"),
    ("runs annotate empty --note text", 4, "empty"),
    ("resume empty", 4, "empty"),
    ("compare", 2, "name the runs to compare, or a condition"),
    ("compare run --where seed=7", 2, "name the runs to compare, or a condition, not both"),
    ("compare run run-b", 2, "there is no run run-b"),
    ("compare --where seed=8 --runs-dir .", 2, "no run in"),
    ("compare run --by run", 2, "nothing to compare: there is only one group: run"),
    ("compare run --quantity reason", 2, "reason"),
    # templates and maps
    ("calibrate template run --out tip.png --frame 9999", 4, "holds no frame 9999; it holds 8"),
    ("calibrate template run --out tip.png --tip-px 2 2 --heading-deg 0", 2, "border"),
    ("calibrate template run --out tip.png --tip-px nan 5", 2, "nan"),
    ("calibrate template run --out taken.png --frame 3", 2, "taken.json exists"),
    (f"{TIP} alone.png", 2, "alone"),
    (f"{TIP} other.png", 2, "other.json"),
    (PLANE, 2, "--px-per-mm"),
    (f"{PLANE} --px-per-mm 12 --distance-mm 70", 2, "--distance-mm"),
    (f"{PLANE} --distance-mm 70", 2, "--intrinsics"),
    # devices
    (f"devices camera --rig {RIG} --save frame.jpg", 2, "is no PNG file"),
    (f"devices jog --axis insert --rig {RIG}", 2, "labrig devices jog --help"),
    (f"devices home --axis insertion --method -4 --rig {RIG}", 3, "labrig devices home --axis insertion --method 35"),
    (f"devices home --method 5 --rig {RIG}", 2, "use one of"),
    (f"devices jog --axis linear --distance 100 --rig {RIG}", 2, "labrig devices home --axis linear"),
    (f"devices jog --axis linear --speed 50 --rig {RIG}", 2, "slower"),
    (f"devices withdraw --rig {RIG}", 2, "nothing to withdraw"),
    # campaigns
    (f"{REACH} --workers 2 --cluster tcp://127.0.0.1:1 --out o", 2, "exclude each other"),
    (f"{REACH} --set rig={ROOT}/calibration/rig-bench.yaml --out o", 2, "simulated rigs only"),
    ("campaign", 2, "Missing argument 'FILE'"),
    ("campaign campaign-x", 2, "there is no campaign campaign-x"),
]  # fmt: skip


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a run, broken protocols, and files that a command could replace."""
    folder = tmp_path_factory.mktemp("prepared")
    shutil.copytree(KEPT, folder / "run")
    (folder / "empty").mkdir()
    for name in ("text.png", "taken.json", "notes.md"):
        (folder / name).write_text("# Notes\n\n- `a`: b: c\n", encoding="utf-8")
    for name in ("alone.png", "other.png"):
        shutil.copy(RIG.parent / "simulated-tip.png", folder / name)
    (folder / "other.json").write_text('{"kind": "labrig-plane"}', encoding="utf-8")
    for name, text in BROKEN.items():
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    return folder


def contents(folder: Path) -> dict[Path, bytes]:
    """Return every file of a folder."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file() and path.name[0] != "."}


@pytest.mark.parametrize(
    ("line", "exit_code", "words"), ROWS, ids=[row[0].replace(str(ROOT), "")[:60] for row in ROWS]
)
def test_what_cannot_be_done_is_refused_by_name_and_writes_nothing(
    line: str, exit_code: int, words: str, labrig: Labrig, prepared: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error says what is wrong and the hint what to do, in one JSON document; there is no traceback."""
    monkeypatch.chdir(prepared)
    before = contents(prepared)
    done = labrig(*shlex.split(line), "--json")
    told = json.dumps(done.json(), ensure_ascii=False)
    assert (done.exit_code, words in told, "Traceback" in done.err) == (exit_code, True, False), told
    assert contents(prepared) == before
