"""Commands that read runs: what `test_every_verb` does not see of annotate, reanalyze, replay, export and compare."""

import csv
import io
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import cv2
import pytest

from labrig.errors import InputError
from labrig.library.door import write_report
from labrig.record.json_lines import decode_line, encode_line
from labrig.record.layout import encode_sums, read_sums
from labrig.record.lock import FileLock
from labrig.record.notes import annotate_run
from tests.analysis.measured_runs import write_measured_run
from tests.cli.conftest import ROOT, Labrig
from tests.cli.cut_runs import open_again
from tests.cli.test_refusals import contents
from tests.record.runs import ENDED, begin, closed_run, flip_bit
from tests.report.conftest import HOSTILE

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
RECORDS = ROOT / "tests" / "records"
FIRST = RECORDS / "steerability"


@pytest.fixture
def shelf(tmp_path: Path) -> Path:
    """Return a folder with two copies of a sweep."""
    for name in ("one", "two"):
        shutil.copytree(FIRST, tmp_path / "shelf" / name)
    return tmp_path / "shelf"


def test_what_people_say_is_kept_in_the_run(labrig: Labrig, shelf: Path) -> None:
    """Tags, notes and a verdict are added to several runs, taken back, listed beside what --set changed, and shown."""
    runs = (shelf / "one", shelf / "two")
    said = ("--tag", "pilot", "--note", "gel was cloudy", "--verdict", "doubtful", "--by", "Chen")
    assert labrig("runs", "annotate", *runs, *said).exit_code == 0
    assert labrig("runs", "annotate", runs[0], "--untag", "pilot", "--note", "gel 3").exit_code == 0
    rows = labrig("runs", "annotate", *runs, "--json").json()
    told = [(row["tags"], row["verdict"], len(row["notes"])) for row in rows]
    assert told == [([], "doubtful", 2), (["pilot"], "doubtful", 1)]
    where = ("--where", "gelatin_percent=13 and tag=pilot")
    (row,) = labrig("runs", "--runs-dir", shelf, *where, "--json").json()
    assert Path(row["run"]).name == "two"
    listed = labrig("runs", "--runs-dir", shelf).out
    assert re.search(r"  doubtful, steerability, noise_sd=0, state_rate_hz=2, .*, pilot, 1 note\n", listed)
    document, shown = labrig("runs", "show", runs[1], "--json").json(), labrig("runs", "show", runs[1]).out
    assert (document["notes"][0]["text"], document["notes"][0]["by"]) == ("gel was cloudy", "Chen")
    assert document["result"]["mean_radius_mm"] > 20
    assert len(document["events"]) > len(shown.splitlines()) > 10
    assert ("Chen: gel was cloudy" in shown, "trial 1" in shown) == (True, True)
    done = labrig("runs", "--runs-dir", shelf, "--where", "gelatin_percent=11")
    assert (done.exit_code, done.out, done.err) == (0, "", "no run matches\n")


def test_the_list_says_what_to_do_about_interrupted_runs(labrig: Labrig, tmp_path: Path) -> None:
    """Withdraw a needle that may be in tissue first, then continue; or who writes it. One that is judged is done."""
    for name, kind in (("a sweep", "bench"), ("needle", "bench"), ("other", "simulated")):
        experiment = "steerability" if name == "a sweep" else "roll-zero"
        sources = {"rig": "the bench.yaml" if kind == "bench" else None}
        recorder = begin(
            tmp_path / "writing",
            name,
            trials_planned=3 * (name == "a sweep"),
            experiment=experiment,
            devices={"kind": kind},
            sources=sources,
        )
        recorder.event("trial_start", 0.0, trial=0)
        shutil.copytree(tmp_path / "writing" / name, tmp_path / "runs" / name)
    place = tmp_path / "runs"
    listed = labrig("runs", "--runs-dir", place)
    assert ", rig the bench\n" in listed.out
    withdraw = "labrig devices withdraw --rig 'the bench.yaml' --run"
    for words in (
        f"a sweep was interrupted; take out a needle that is still in tissue: {withdraw} '{place}/a sweep'\n",
        f"\n  then continue it: labrig resume '{place}/a sweep'",
        f"{withdraw} {place}/needle\n",
        f"labrig runs annotate {place}/other --verdict bad",
    ):
        assert words in listed.err
    labrig("runs", "annotate", f"{place}/needle", "--verdict", "bad")
    with FileLock(place / "other" / ".lock").acquire("labrig run"):
        said = labrig("runs", "--runs-dir", place).err
    assert "other is going on: labrig run (process" in said
    assert "needle was interrupted" not in said


def test_several_runs_are_reanalyzed_at_once(labrig: Labrig, shelf: Path) -> None:
    """Unchanged settings give identical numbers; changed ones name the first picture that differs; --where chooses."""
    runs = [shelf / "one", shelf / "two"]
    labrig("runs", "annotate", runs[0], "--tag", "pilot")
    where = ("--where", "tag=pilot", "--runs-dir", shelf)
    (row,) = labrig("reanalyze", *where, "--set", "analysis.window_start_mm=5", "--json").json()
    assert (row["run"], row["ok"], row["parent"]) == (str(runs[0]), True, 1)
    assert row["first_difference"]["frame"] is not None
    own = labrig("reanalyze", *runs, "--json").json()
    assert [Path(row["analysis"]).name for row in own] == ["003", "002"]
    assert [(row["parent"], row["first_difference"]) for row in own] == [(1, None), (1, None)]
    printed = labrig("reanalyze", *runs, "--set", "analysis.window_start_mm=3").out
    assert len(re.findall(r"other numbers; the first that changed is in frame \d+\n", printed)) == 2
    assert "old: analysis/003, the run's own settings" in printed
    assert "new: analysis/004, analysis.window_start_mm=3" in printed


def test_the_headline_names_a_result_that_was_chosen_or_has_other_settings(
    labrig: Labrig, tmp_path: Path
) -> None:
    """A notebook shows another one; a verdict against the run changes the badge; an unknown number is wrong."""
    run = shutil.copytree(RECORDS / "import", tmp_path / "import")
    labrig("reanalyze", run, "--set", "analysis.window_start_mm=5")
    labrig("runs", "annotate", run, "--verdict", "doubtful")
    newest, first = (
        write_report(run, result=number).read_text(encoding="utf-8").split("</header>")[0]
        for number in (None, 1)
    )
    told = "with settings changed after the run: <code>analysis.window_start_mm=5</code>. The one before"
    assert told in newest
    told = "note: Result 2 of import has settings changed after the run: analysis.window_start_mm=5."
    assert told in " ".join(labrig("export", run, "--out", tmp_path / "tables").err.split())
    assert '<span class="pill doubtful">complete, judged doubtful</span>' in newest
    assert ("Result 1 is shown; the newest is 2." in first, "settings changed" in first) == (True, False)
    with pytest.raises(InputError):
        write_report(run, result=9)


@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed, so the page is not opened")
def test_a_browser_shows_the_page_without_an_error(labrig: Labrig, shelf: Path, tmp_path: Path) -> None:
    """Headless Chromium loads the report with its figures without an error."""
    picture = tmp_path / "page.png"
    assert labrig("report", shelf / "one").exit_code == 0
    command = [
        str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
        "--disable-background-networking", "--disable-component-update", "--disable-sync",
        f"--user-data-dir={tmp_path / 'profile'}", f"--screenshot={picture}", "--window-size=1200,3000",
        (shelf / "one" / "report.html").as_uri(),
    ]  # fmt: skip
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    assert picture.stat().st_size > 50_000


def test_an_export_is_a_folder_of_its_own_and_no_run(
    labrig: Labrig, shelf: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without --out it is data/exports/RUN; a list shows copies of records, and neither tables nor unfinished ones."""
    monkeypatch.chdir(shelf.parent)
    document = labrig("export", shelf / "one", "--json").json()
    assert document["out"] == "data/exports/one"
    assert {path.name for path in Path(document["out"]).iterdir()} == {*document["files"]}
    for form, out in (("csv", "shelf/tables"), ("record", "shelf/copy")):
        done = labrig("export", "shelf/one", "--format", form, "--out", out)
        assert (done.exit_code, "\nopen measurements.csv first" in done.out) == (0, form == "csv")
    both = labrig("export", "shelf/one", "--format", "film", "--format", "csv", "--out", "shelf/both")
    assert (both.exit_code, "shelf/both/run.csv" in both.out) == (2, True)
    shutil.move("shelf/two", "shelf/.copy-unfinished")
    listed = labrig("runs", "--runs-dir", "shelf", "--where", "exit_status=success", "--json").json()
    assert sorted(row["run"] for row in listed) == ["shelf/copy", "shelf/one"]
    closed_run(shelf, "other")
    replaced = labrig("export", "shelf/other", "--format", "record", "--out", "shelf/copy", "--force")
    assert (replaced.exit_code, labrig("runs", "check", "shelf/copy").exit_code) == (2, 0)


def test_an_insertion_is_exported_as_a_film(labrig: Labrig, tmp_path: Path) -> None:
    """It has every picture of a step, in colour."""
    out = labrig("export", RECORDS / "insertion", "--format", "film", "--out", tmp_path, "--force", "--json")
    assert out.json()["files"] == ["insertion-1.mp4"]
    film = cv2.VideoCapture(str(tmp_path / "insertion-1.mp4"))
    read, first = film.read()
    assert read
    assert abs(first[..., 2].astype(int) - first[..., 0]).max() > 100
    assert film.get(cv2.CAP_PROP_FRAME_COUNT) > 20


Change = Callable[[dict[str, Any]], dict[str, Any]]


def copy_edited(name: str, tmp_path: Path, change: Change) -> Path:
    """Return an open copy of a kept record with other events, each with its checksum."""
    run = Path(shutil.copytree(ROOT / "tests" / "records" / name, tmp_path / name))
    lines = [decode_line(line) for line in (run / "events.jsonl").read_bytes().splitlines()]
    (run / "events.jsonl").write_bytes(b"".join(encode_line(change(line)) for line in lines))
    open_again(run)
    return run


def test_a_difference_exits_with_1_and_both_values(labrig: Labrig, tmp_path: Path) -> None:
    """The first difference is printed with the recorded and the new value, its picture and its trial."""

    def ask_more(line: dict[str, Any]) -> dict[str, Any]:
        return line | {"asked_position": 23.0} if line.get("asked_position") == 22.0 else line

    run = copy_edited("steerability", tmp_path, ask_more)
    done = labrig("replay", run, "--json")
    document = done.json()
    assert (done.exit_code, document["verdict"], document["identical"]) == (1, "different", False)
    assert document["first_difference"] | {"t_s": None, "frame": None} == {
        "path": "move.insertion_mm", "recorded": 23.0, "now": 22.0, "size": 1.0, "tolerance": 0.0025,
        "sd": None, "t_s": None, "frame": None, "trial": 0, "went_on": True,
    }  # fmt: skip
    done = labrig("replay", run)
    assert (done.exit_code, "in the record: 23.0" in done.out) == (1, True)
    assert "they differ by 1; 0.0025 is allowed" in done.out


@pytest.mark.parametrize(
    ("command", "lost", "reason"),
    [("replay", "confirmed", "confirmed"), ("replay", "", "704x448"), ("reanalyze", "", "intrinsics")],
)
def test_a_record_that_cannot_be_used_says_why(
    tmp_path: Path, labrig: Labrig, command: str, lost: str, reason: str
) -> None:
    """A lost answer and a calibration of other pictures; nothing is written."""
    run = copy_edited("roll-zero", tmp_path, lambda line: {key: line[key] for key in line if key != lost})
    if not lost:
        path = run / "calibration" / "intrinsics.json"
        lens = json.loads(path.read_text(encoding="utf-8"))
        path.write_text(json.dumps(lens | {"image_size": [704, 448]}), encoding="utf-8")
        sums = {**read_sums(run), "calibration/intrinsics.json": sha256(path.read_bytes()).hexdigest()}
        (run / "SHA256SUMS").write_bytes(encode_sums(sums))
    before = contents(run)
    done = labrig(command, run, "--json")
    assert (done.exit_code in {2, 4}, reason in done.out) == (True, True), done.out
    assert contents(run) == before


SOFT, HARD = ("gel A", 10.0), ("gel B", 19.0)


@pytest.fixture
def runs_dir(tmp_path: Path) -> Path:
    """Return a folder with two runs of two needles in two gels, and with two stores of pictures."""
    folder, radii = tmp_path / "runs", {SOFT: (28.1, 28.3, 28.6), HARD: (26.8, 27.2, None)}
    write_measured_run(folder, "a", {SOFT: (28.0, 28.4, 28.3), HARD: (27.0, 27.2, 27.5)})
    write_measured_run(folder, "b", radii, needle_id="N2", protocol="store: png\n")
    return folder


def test_a_comparison_prints_and_writes_a_document(labrig: Labrig, runs_dir: Path, tmp_path: Path) -> None:
    """The keys that others rely on; one tidy row for each measurement; an existing folder is not overwritten."""
    command = ("compare", "a", "b", "--runs-dir", runs_dir, "--out", tmp_path / "out", "--json")
    done = labrig(*command)
    document = done.json()
    counts = (len(document["groups"]), len(document["pairs"]))
    assert (done.exit_code, document["quantity"], counts) == (0, "radius_mm", (4, 6))
    assert document["groups"][0].keys() >= {"name", "n", "runs", "mean", "sd", "ci95"}
    assert document["welch_anova"].keys() >= {"f", "df_between", "df_within", "p"}
    assert document["pairs"][0].keys() >= {"a", "b", "difference", "ci95", "p"}
    assert document["report"] == str(tmp_path / "out" / "report.html")
    table = (tmp_path / "out" / "measurements.csv").read_text(encoding="utf-8")
    rows = list(csv.DictReader(io.StringIO(table)))
    written = json.loads((tmp_path / "out" / "measurements.json").read_text(encoding="utf-8"))["measurements"]
    assert (len(rows), len(written), rows[0]["group"]) == (12, 12, "N1, 10 % gelatin")
    assert [float(row["value"]) for row in rows[:3]] == [28.0, 28.4, 28.3]
    assert labrig(*command).json()["error"]["type"] == "OutputExistsError"


def test_the_page_shows_what_people_wrote_as_text(labrig: Labrig, tmp_path: Path) -> None:
    """Markup in the name of a needle, of a specimen or of a verdict is shown, and a formula in a cell is none."""
    radii = {(HOSTILE, 10.0): (28.0, 28.4), ("=1+1", 19.0): (27.0, 27.2)}
    run = write_measured_run(tmp_path, "a", radii, needle_id=HOSTILE)
    annotate_run(run, verdict="doubtful", note=HOSTILE, by="somebody", at=ENDED)
    done = labrig("compare", run, "--by", "specimen", "--by", "needle", "--out", tmp_path / "out")
    html = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert done.exit_code == 0
    assert "<script" not in html
    assert "&lt;script&gt;" in html
    assert "a was judged doubtful" in html
    assert "\n=1+1" not in (tmp_path / "out" / "measurements.csv").read_text(encoding="utf-8")
    assert "=1+1, &lt;script" in html


def test_a_run_that_cannot_be_used_is_told(labrig: Labrig, runs_dir: Path, tmp_path: Path) -> None:
    """One without result is wrong input where it is named; a damaged one changes the exit code."""
    write_measured_run(runs_dir, "c", {SOFT: (28.0,)}, result=False)
    where = ("compare", "--where", "seed=7", "--runs-dir", runs_dir, "--json", "--out")
    found = labrig(*where, tmp_path / "x")
    (left_out,) = found.json()["left_out"]
    assert (found.exit_code, "has no result" in left_out["reason"]) == (0, True)
    assert labrig("compare", "a", "c", "--runs-dir", runs_dir, "--out", tmp_path / "y").exit_code == 2
    flip_bit(runs_dir / "b" / "analysis" / "001" / "measurements.csv")
    damaged = labrig(*where, tmp_path / "z")
    assert (damaged.exit_code, "left out" in damaged.err) == (4, True)
    assert [run["run"] for run in damaged.json()["used"]] == ["a"]
    assert {Path(run["run"]).name for run in damaged.json()["left_out"]} == {"b", "c"}
