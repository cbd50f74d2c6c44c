"""Make the result of a run, or of many at once with the same workers: those of one run after another."""

import platform
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from datetime import datetime
from difflib import get_close_matches
from functools import partial
from itertools import accumulate
from pathlib import Path
from typing import Any

from labrig.analysis.engine import DEFAULT_WORKERS, Pool, run_in_order
from labrig.analysis.experiment import AnalysisRequest, MeasuredExperiment
from labrig.analysis.pictures import MASK_FILE, Progress, load_mask_of_run
from labrig.analysis.result import AnyResult, LeftOutTrials, Result, load_result, write_result
from labrig.errors import AnswerIsNoError, InputError, LabrigError, Problem, RecordError, WorkersError
from labrig.plugins import require_devices_installed
from labrig.protocol.load import load_recorded_protocol
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.check import find_damage
from labrig.record.layout import FRAMES, MANIFEST, hash_file
from labrig.record.reader import Run, open_run
from labrig.record.results import finish_result, new_result_dir

RunsProgress = Callable[[int, int, Path], None]
ExperimentOf = Callable[[Run], MeasuredExperiment]
Outcome = AnyResult | LabrigError


def analyze_run(
    run: Run,
    experiment: MeasuredExperiment,
    *,
    overrides: Sequence[str] = (),
    workers: int = DEFAULT_WORKERS,
    progress: Progress | None = None,
    created: datetime,
    provenance: Mapping[str, Any],
) -> AnyResult:
    """Measure a run, or study its design, and write a new numbered result, `RUN/analysis/NNN/`.

    Parameters
    ----------
    experiment : MeasuredExperiment
        The experiment of the run.
    overrides : sequence of str
        Changes to the protocol, `section.key=value` each; stored in the result.
    workers : int
        Processes that measure or search. The result does not depend on their number.
    progress : callable or None
        Called with the number of finished pictures (of a design: hinges) and the number of all.
    created : datetime
        Calendar time, aware.
    provenance : Mapping
        Code version, packages, host and command line, as `labrig.record.collect_provenance` gives them.

    Raises
    ------
    InputError
        When an override is not in a section that may be changed, or the run has no map from pixels to mm.
    FileFormatError
        When an override cannot be used, or a calibration file of the run is malformed.
    RecordError
        When the run's lines are damaged.
    DiskError, MachineError
        When the result cannot be written, or worker processes die of the same picture.
    """
    if run.withdraws is not None:
        raise InputError(
            f"{run.path} is the withdrawal of the needle of run {run.withdraws}; it has no pictures to measure",
            f"labrig reanalyze {run.path.parent / run.withdraws}",
        )
    require_devices_installed(str(run.path), run.plugin_packages)
    protocol = _resolve_protocol(run, experiment, overrides)
    damage = tuple(find_damage(run.path, run.manifest, read_pictures=True))
    stamp = Result(
        settings={},
        parent=_find_parent(run, experiment),
        created=created.isoformat(timespec="seconds"),
        overrides=tuple(overrides),
        inputs=_hash_inputs(run),
        provenance=dict(provenance),
        damage=tuple(f"{problem.where}: {problem.message}" for problem in damage),
        left_out=LeftOutTrials.of(run.decisions),
    )
    request = AnalysisRequest(stamp, load_mask_of_run(run), workers, progress)
    with name_damage(run.path, damage):
        findings = experiment.part("analyze")(run, protocol, request)
    # The folder is made last, so that an analysis that fails leaves nothing behind.
    result = write_result(new_result_dir(run.path), findings)
    finish_result(result.path)
    return result


@contextmanager
def name_damage(path: Path, damage: Sequence[Problem]) -> Iterator[None]:
    """Name the damage of a run where too little is left of it to be measured or shown. Raises `RecordError`."""
    try:
        yield
    except (AnswerIsNoError, InputError) as error:
        if not damage:
            raise
        first = damage[0]
        message = f"{path} is damaged: {first.where}: {first.message}; {error.message}"
        raise RecordError(message, first.hint) from error


def _find_parent(run: Run, experiment: MeasuredExperiment) -> int | None:
    """Return the number of the newest result with the run's own settings, else of the newest readable result."""
    readable: dict[int, bool] = {}
    for number in reversed(run.result_numbers):
        with suppress(RecordError):
            result = load_result(run, experiment.part("RunResult"), number)
            readable[number] = result is not None and not result.content.overrides
    return next((number for number, is_own in readable.items() if is_own), next(iter(readable), None))


def _resolve_protocol(
    run: Run, experiment: MeasuredExperiment, overrides: Sequence[str]
) -> ExperimentProtocol:
    """Return the run's protocol with the overrides; only how the run is measured can be changed."""
    known = experiment.reanalysis_keys
    for override in overrides:
        key = override.partition("=")[0]
        if not any(key.startswith(f"{each}.") or ("." in each and key == each) for each in known):
            near = get_close_matches(key.partition(".")[0], known, 1)
            named = ", ".join(each if "." in each else f"{each}.*" for each in known)
            can = f"only {named} can" if known else "nothing can"
            raise InputError(
                f"{override!r} cannot be changed after a run of {experiment.name}: {can}",
                f"did you mean {near[0]}.?" if near else f"run it again with --set {override}",
            )
    return load_recorded_protocol(run.protocol_path, {experiment.name: experiment.protocol_model}, overrides)


def _hash_inputs(run: Run) -> dict[str, str]:
    """Return the SHA-256 of each file behind the result; frames.jsonl holds those of the pictures."""
    names = ["protocol.yaml", "frames.jsonl", "events.jsonl", "truth.jsonl"]
    kept = [
        name for name in run.calibration_files if name.endswith(".json") or name.startswith(f"{MASK_FILE}.")
    ]
    names += [f"calibration/{name}" for name in kept]
    return {name: hash_file(run.own(name)) for name in names if run.own(name).is_file()}


def analyze_runs(
    runs: Sequence[Path],
    find_experiment: ExperimentOf,
    pool: Pool,
    *,
    overrides: Sequence[str] = (),
    progress: RunsProgress | None = None,
    created: datetime,
    provenance: Mapping[str, Any],
) -> Generator[tuple[Path, Outcome], None, None]:
    """Analyse runs, each into a new numbered result; a failure does not stop the others.

    Each worker analyses whole runs, so that memory does not grow with their number.

    Parameters
    ----------
    runs : sequence of Path
        Their folders, each once.
    find_experiment : callable
        Returns the experiment of a run; it is pickled by name.
    pool : Pool
        The workers. Those of a cluster read and write the same folders, by absolute paths.
    progress : callable or None
        Called with the number of finished pictures, the number in all runs, and the run at hand. A run without
        pictures, such as a design, counts as one.
    overrides, created, provenance
        As for `analyze_run`.

    Yields
    ------
    tuple
        Each run, in the order given, and its result, or the error; a `MachineError` where workers die of a run again.

    Raises
    ------
    WorkersError
        When the pool can do no further task, or a worker does not see a run. What is done stays done.
    """
    task = partial(
        _analyze,
        find_experiment=find_experiment,
        overrides=tuple(overrides),
        created=created,
        provenance=dict(provenance),
    )
    sizes = [max(1, sum(1 for _ in (run / FRAMES).glob("*"))) for run in runs]
    with closing(run_in_order(pool, task, ((run, (run / MANIFEST).is_file()) for run in runs))) as outcomes:
        for run, outcome, done in zip(runs, outcomes, accumulate(sizes), strict=True):
            if progress is not None:
                progress(done, sum(sizes), run)
            yield run, outcome


def _analyze(seen: tuple[Path, bool], *, find_experiment: ExperimentOf, **how: Any) -> AnyResult:
    """Analyse a run, which this computer sees or not, in a worker.

    Raises
    ------
    WorkersError
        When the worker does not see what this computer does: each of its pictures would be called missing.
    """
    run, is_there = seen
    if is_there and not (run / MANIFEST).is_file():
        raise WorkersError(
            f"a worker on {platform.node()} does not see {run / MANIFEST}",
            "keep runs in a folder that this computer and all workers have under the same name",
        )
    opened = open_run(run)
    return analyze_run(opened, find_experiment(opened), workers=1, **how)
