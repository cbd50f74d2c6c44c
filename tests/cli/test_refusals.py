"""What commands refuse: the line, its exit code, and words of its error or hint. No file is written or replaced.

A row of `ROWS` is a command line in a folder of prepared files; a row of `SPOILT` is what has happened to a run, for
every command that takes one.
"""

import json
import os
import shlex
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from labrig.record.json_lines import encode_manifest
from tests.cli.conftest import RIG, ROOT, SCENARIO, SWEEP, Labrig
from tests.record.runs import closed_run, flip_bit

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
    "radius_mm=8.9": "cuts the socket's lips through",
    "radius_mm=49.4": "no inclination gives",
    "tube.inner_diameter_mm=1.3": "must be below outer_diameter_mm, 1.2",
    "tube.inner_diameter_mm=0.05": "inner_diameter_mm is 0.05, must be greater than or equal to 0.1",
    "tube.link_length_mm=0.5": "at least 0.928 mm",
    "tolerances.clearance_mm=3": "less than or equal to 0.05",
    "tolerances={clearance_mm: 0.05, cut_deg: 10}": "might not turn at all",
    "measured.beta_cut_deg=44": "cutting inclination is 44 degrees",
    "grid_points=2": "grid_points is 2",
}
INSIDE = ("radius_mm=9", "radius_mm=49.3", "grid_points=3")
"""Just inside a limit of the designs that are refused."""
NEEDLE = {"radius_mm": 30, "diameter_mm": 1.2}
SCENARIOS: Mapping[str, tuple[str, object, str]] = {
    "nan": ("clearance_mm", float("nan"), "must be a valid number"),
    "radius": ("needle", NEEDLE | {"radius_mm": 0}, "radius_mm is 0, must be greater than 0"),
    "half": ("needle", NEEDLE | {"radius_range_mm": [28]}, "radius_range_mm is [28], must be a list of 2"),
    "range": ("needle", NEEDLE | {"radius_range_mm": [31, 33]}, "radius_range_mm is not about radius_mm, 30"),
    "obstacle": ("obstacles", [{"position_mm": [0, 0, 50], "radius_mm": -3}], "obstacles.0.radius_mm: radius_mm is -3"),
    "method": ("method", "magic", "must be 'best' or 'paper'"),
    "key": ("clearence_mm", 1, "unknown key clearence_mm"),
    "point": ("target", {"position_mm": [0, 100]}, "position_mm is [0, 100], must be a list of 3"),
    "rotation": ("start", {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 2]]}, "upper left 3x3 of start is not a rotation"),
}  # fmt: skip
INTO_ITSELF = ("run", "run/tables", "empty/../run", "same", "same/frames")
TIP = "measure tip run/frames/000003.png --px-per-mm 10 --origin-px 0 0 --insertion right --template"
REACH = f"campaign {ROOT}/protocols/campaign-reach.yaml"
PLANE = "calibrate plane run/frames/000003.png --origin-px 3 4 --insertion right"

FEW = "--set insertions_per_specimen=1"
FOCUS = f"--rig focus/{RIG.name} {FEW}"
LENS = f"rig.calibration.intrinsics={RIG.parent}/simulated-intrinsics.json"

ROWS: list[tuple[str, int, str]] = [
    # files
    *((f"run {name}.yaml --rig {RIG}", 2, f"{name}.yaml") for name in BROKEN if name != "misspelt"),
    (f"run misspelt.yaml --rig {RIG}", 2, "did you mean hole_spacing_mm?"),
    ("run nowhere.yaml", 2, "nowhere.yaml"),
    ("run notes.md", 2, "notes.md"),
    ("run steerability", 2, "labrig init FOLDER"),
    (f"check {RIG}", 2, "this is a rig file, expected a protocol"),
    (f"check {SWEEP} --rig {SWEEP}", 2, "this is a protocol, expected a rig file"),
    (f"run {SWEEP} --rig {RIG} --set rig.recording.least_free_mb=1e6 {FEW}", 3, "MB"),
    ("measure curvature text.png --px-per-mm 5 --origin-px 10 10 --insertion right", 2, "text.png"),
    ("calibrate intrinsics a.png --board 9x6 --square-mm 25 --out taken.json", 2, "taken.json exists"),
    ("calibrate intrinsics a.png --board 999999999x999999999 --square-mm 2", 2, "from 3x3 to 99x99"),
    ("import empty --px-per-mm 5 --origin-px 0 0", 2, "empty"),
    ("check pipe.yaml", 2, "a pipe"),
    ("plan pipe.yaml", 2, "a pipe"),
    ("report piped", 4, "is no run"),
    *((f"plan scenario-{name}.json", 2, words) for name, (_, _, words) in SCENARIOS.items()),
    (f"run {SWEEP} {FOCUS}", 2, "simulated-intrinsics.json was made with camera.focus 12, it is 0 now"),
    (f"run {SWEEP} {FOCUS} --set {LENS}", 2, "simulated-plane.json was made with camera.focus 12"),
    (f"run {SWEEP} {FOCUS} --set rig.camera.focus=7", 2, "write camera.focus: 12 in the rig file, or"),
    (f"run {SWEEP} --rig {RIG} --set rig.calibration.mask=clamp.png", 2, "clamp.png does not exist"),
    (f"run {SWEEP} {FEW} --rig {RIG} --runs-dir . --run-name run", 2, "run exists already"),
    (f"check {SWEEP} {FOCUS} --set rig.camera.focus=12", 0, ""),
    # options
    ("plan --figur x", 2, "see: labrig plan --help"),
    ("runs chek", 2, "see: labrig runs --help"),
    ("rusn", 2, "see: labrig --help"),
    (f"devices jog --axis linear --distance nan --rig {RIG}", 2, "--distance is nan"),
    ("design --radius-mm 1e999", 2, "--radius-mm is inf"),
    ("measure tip a.png --template t.png --near-px 3 -inf", 2, "--near-px is -inf"),
    # designs
    ("design --clearance-mm 30", 2, "give a value from 0.001"),
    ("design --clearance-mm 0", 2, "laser clearance is 0 mm"),
    ("design --radius-mm 0.03", 2, "give a value from 3.82"),
    *(
        (f"run {ROOT}/protocols/design.yaml --set '{setting}'", 2, words)
        for setting, words in DESIGNS.items()
    ),
    (f"run {ROOT}/protocols/design.yaml --rig {RIG}", 2, "moves no rig"),
    (f"run {ROOT}/protocols/design.yaml --set rig.world.noise_sd=0", 2, "moves no rig"),
    *((f"check {ROOT}/protocols/design.yaml --set {inside}", 0, "") for inside in INSIDE),
    # runs
    ("export run --format record --format csv --out x", 2, "record"),
    ("export run --format x", 2, "x"),
    ("export run --format film --out x", 2, "film"),
    ("export run --format csv --out tables", 2, "OutputExistsError"),
    ("export run --format csv --out other --force", 2, "OutputExistsError"),
    ("export run --format record --out other --force", 2, "OutputExistsError"),
    *(
        (f"export run --format {form} --out {place} --force", 2, "InputError")
        for form in ("csv", "record")
        for place in INTO_ITSELF
    ),
    ("export damaged --format record --out x", 4, "--force copies it as it is"),
    *((f"{verb} kep", 2, "did you mean kept?") for verb in ("reanalyze", "report", "replay", "runs show")),
    (f"run {SWEEP} --set target.position_mm=[0, 5, 90]", 2, "put quotes around a value with blanks"),
    ("reanalyze", 2, "--where"),
    ("reanalyze run --where tag=pilot", 2, "--where"),
    ("reanalyze --where needle=none --runs-dir .", 2, "needle"),
    ("reanalyze run --set analyis.window_start_mm=5", 2, "only analysis.* can"),
    ("reanalyze run --set analysis.window_strt_mm=5", 2, "unknown key window_strt_mm"),
    ("runs --runs-dir . --where gelatin_percent", 2, "character"),
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
    ("calibrate template run/frames/000003.png --out tip.png --tip-px 150 110", 2, "--heading-deg"),
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
    ("devices withdraw --rig focus/remembering.yaml", 2, "has new gel"),
    # campaigns
    (f"{REACH} --workers 2 --cluster tcp://127.0.0.1:1 --out o", 2, "exclude each other"),
    (f"{REACH} --set rig={ROOT}/calibration/rig-bench.yaml --out o", 2, "simulated rigs only"),
    ("campaign", 2, "Missing argument 'FILE'"),
    (f"campaign {SWEEP}", 2, "this is a protocol, expected a campaign file"),
    (f"campaign {RIG}", 2, "this is a rig file, expected a campaign file"),
    ("campaign campaign-x", 2, "there is no campaign campaign-x"),
]  # fmt: skip


DESIGN = f"check {ROOT}/protocols/design.yaml"
COMMANDS: Mapping[str, str] = {
    "check": "runs check RUN", "show": "runs show RUN", "resume": "resume RUN", "replay": "replay RUN",
    "reanalyze": "reanalyze RUN", "report": "report RUN", "view": "view RUN",
    "export csv": "export RUN --format csv --out TABLES",
    "export record": "export RUN --format record --out TABLES",
    "annotate": "runs annotate RUN --tag pilot --note cloudy", "adopt": "calibrate adopt RUN",
}  # fmt: skip
"""Every command that takes a run."""


def _newer(run: Path) -> None:
    document = json.loads((run / "manifest.json").read_text(encoding="utf-8")) | {"schema_version": 99}
    (run / "manifest.json").write_bytes(encode_manifest(document))


def _file(run: Path) -> None:
    shutil.rmtree(run)
    run.write_text("no run")


def _flip(name: str) -> Callable[[Path], object]:
    return lambda run: flip_bit(run / name)


def _link(name: str) -> Callable[[Path], object]:
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
SPOILT: Mapping[str, tuple[Callable[[Path], object], str, frozenset[str]]] = {
    "a folder": (lambda run: (run / "manifest.json").unlink(), NO_RUN, frozenset()),
    "a file": (_file, NO_RUN, frozenset()),
    "nothing": (shutil.rmtree, NO_RUN, frozenset()),
    "a link": (_link(""), NO_RUN, frozenset()),
    "newer": (_newer, NO_RUN, frozenset()),
    "a changed picture": (
        _flip("frames/000001.png"), "000001.png", frozenset(COMMANDS) - {"check", "view", "export record"},
    ),
    "a lost picture": (lambda run: (run / "frames" / "000001.png").unlink(), "frames/000001.png", MEASURING),
    "changed states": (_flip("states.jsonl"), "states.jsonl", MEASURING),
    "a changed protocol": (_flip("protocol.yaml"), "protocol.yaml", MEASURING),
    "no sums": (lambda run: (run / "SHA256SUMS").unlink(), "SHA256SUMS", MEASURING),
    "linked states": (_link("states.jsonl"), "states.jsonl", MEASURING),
    "a linked folder": (_link("calibration"), "calibration", MEASURING),
    "linked results": (
        _link("analysis"), "analysis is a symbolic link",
        frozenset(COMMANDS) - {"reanalyze", "report", "view", "export csv", "show"},
    ),
}  # fmt: skip
"""What happened to a run, what is said of it, and the commands that do not read that part."""


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with runs, broken protocols, and files that a command could replace."""
    folder = tmp_path_factory.mktemp("prepared")
    shutil.copytree(KEPT, folder / "run")
    (folder / "same").symlink_to("run")
    for place in ("other", "damaged", "data/runs/kept", "data/runs/run"):
        closed_run((folder / place).parent, Path(place).name)
    flip_bit(folder / "damaged" / "frames" / "000001.png")
    for name in ("empty", "tables", "piped"):
        (folder / name).mkdir()
    for pipe in ("pipe.yaml", "piped/manifest.json"):
        os.mkfifo(folder / pipe)
    for name in ("text.png", "taken.json", "notes.md", "piped/protocol.yaml"):
        (folder / name).write_text("# Notes\n\n- `a`: b: c\n", encoding="utf-8")
    for name in ("alone.png", "other.png"):
        shutil.copy(RIG.parent / "simulated-tip.png", folder / name)
    (folder / "other.json").write_text('{"kind": "labrig-plane"}', encoding="utf-8")
    for name, text in BROKEN.items():
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    for name, (key, value, _) in SCENARIOS.items():
        (folder / f"scenario-{name}.json").write_text(json.dumps(SCENARIO | {key: value}), encoding="utf-8")
    shutil.copytree(RIG.parent, folder / "focus")
    for name in ("simulated-plane.json", "simulated-intrinsics.json"):
        made = json.loads((folder / "focus" / name).read_text(encoding="utf-8"))
        made["provenance"]["camera"] = {"settings": {"focus": 12}}
        (folder / "focus" / name).write_text(json.dumps(made), encoding="utf-8")
    text = RIG.read_text(encoding="utf-8").replace("state_file: null ", "state_file: state.json ")
    (folder / "focus" / "remembering.yaml").write_text(text, encoding="utf-8")
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    """Return every file of a folder that a command may not change."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and not path.is_symlink() and path.name[0] != "."
    }


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


@pytest.mark.parametrize("what", SPOILT)
def test_every_command_names_what_it_cannot_use(what: str, labrig: Labrig, tmp_path: Path) -> None:
    """Exit code 4 and the path, whatever else succeeds; links are not followed, and nothing recorded is changed."""
    how, named, others = SPOILT[what]
    for command in COMMANDS.keys() - others:
        place = tmp_path / command
        (place / "outside").mkdir(parents=True)
        run = closed_run(place / "runs", NO_RUN)
        how(run)
        before = contents(place)
        line = (
            COMMANDS[command]
            .replace("RUN", shlex.quote(str(run)))
            .replace("TABLES", str(tmp_path / "tables"))
        )
        done = labrig(*shlex.split(line), "--json")
        said = done.out + done.err
        assert (done.exit_code, named in said, "Traceback" in said) == (4, True, False), (command, said)
        assert contents(place).items() >= before.items()


def test_a_run_is_found_by_the_name_that_the_list_shows_and_a_damaged_one_is_copied_when_forced(
    labrig: Labrig, prepared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By its name in data/runs; a local folder takes precedence. A copy is whole; its exit code says so."""
    monkeypatch.chdir(prepared)
    found = [labrig("runs", "check", name, "--json").json()[0]["run"] for name in ("kept", "run")]
    assert found == ["data/runs/kept", "run"]
    out = tmp_path / "out"
    forced = labrig("export", "damaged", "--format", "record", "--out", out, "--force", "--json")
    assert (forced.exit_code, forced.json()["ok"]) == (4, False)
    assert contents(out) == contents(prepared / "damaged")
