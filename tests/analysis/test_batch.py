"""Several runs analysed at once."""

import shutil
from pathlib import Path

from labrig.analysis.batch import analyze_runs
from labrig.analysis.divergence import find_divergence
from labrig.analysis.result import AnalysisResult
from labrig.analysis.run import analyze_run
from labrig.errors import FileFormatError, RecordError
from labrig.experiments.registry import find_run_experiment, load_run_result
from labrig.record.reader import open_run
from labrig.vision.mask import load_mask
from tests.analysis.synthetic import NOW, PROVENANCE

FIRST = Path(__file__).parents[2] / "data" / "first-record"


def test_each_run_gets_its_result_and_the_order_is_kept(tmp_path: Path) -> None:
    """Results stand in the order of the runs, each linked to its parent; a folder that is no run has its error."""
    runs = [Path(shutil.copytree(FIRST, tmp_path / name)) for name in ("a", "b", "c")]
    updates: list[tuple[int, int, str]] = []
    outcomes = analyze_runs(
        [*runs, tmp_path / "none"],
        find_run_experiment,
        workers=2,
        progress=lambda done, total, run: updates.append((done, total, run.name)),
        created=NOW,
        provenance=PROVENANCE,
    )
    pictures = [len(open_run(run).frames) for run in runs]
    assert updates == sorted(updates)
    assert [update for update in updates if update[0] == 0] == []
    assert updates[-1] == (sum(pictures) + 1, sum(pictures) + 1, "none")
    assert {update[2] for update in updates} == {"a", "b", "c", "none"}
    assert isinstance(outcomes[3], RecordError)
    results = [outcome for outcome in outcomes if isinstance(outcome, AnalysisResult)]
    assert [result.path for result in results] == [run / "analysis" / "002" for run in runs]
    assert [result.content.parent for result in results] == [1, 1, 1]
    for run, result in zip(runs, results, strict=True):
        read = load_run_result(open_run(run), 2)
        assert read is not None
        assert find_divergence(read.document, results[0].document) is None
        assert find_divergence(result.document, results[0].document) is None


def test_a_wrong_setting_is_told_for_each_run(tmp_path: Path) -> None:
    """An error with several places comes back whole from a worker process, for each run."""
    runs = [Path(shutil.copytree(FIRST, tmp_path / name)) for name in ("a", "b")]
    outcomes = analyze_runs(
        runs,
        find_run_experiment,
        overrides=["analysis.window_start_mm=-1"],
        workers=2,
        created=NOW,
        provenance=PROVENANCE,
    )
    assert [type(outcome) for outcome in outcomes] == [FileFormatError, FileFormatError]
    assert all(isinstance(outcome, FileFormatError) and outcome.problems for outcome in outcomes)


def test_runs_with_a_mask_have_together_what_each_has_alone(tmp_path: Path) -> None:
    """Analysed together, each run keeps its mask and has the numbers of an analysis alone."""
    polygon = tmp_path / "mask.json"
    polygon.write_text('{"*": [[[0, 0], [40, 0], [40, 40]]]}')
    mask = load_mask(polygon)
    runs = [Path(shutil.copytree(FIRST, tmp_path / name)) for name in ("a", "b")]
    alone = [
        analyze_run(
            open_run(run),
            find_run_experiment(open_run(run)),
            workers=1,
            created=NOW,
            provenance=PROVENANCE,
            mask=mask,
        )
        for run in runs
    ]
    together = analyze_runs(
        runs, find_run_experiment, workers=2, created=NOW, provenance=PROVENANCE, mask=mask
    )
    for run, single, other in zip(runs, alone, together, strict=True):
        assert isinstance(other, AnalysisResult)
        assert find_divergence(single.document, other.document) is None
        assert (run / "analysis" / "003" / "mask.json").read_bytes() == mask.content
        assert other.document["settings"]["mask_sha256"] == mask.sha256
