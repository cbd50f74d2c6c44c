"""From a run to its result: the one door."""

import hashlib
from collections.abc import Generator, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from labrig.analysis.experiment import AnalysisRequest, MeasuredExperiment
from labrig.analysis.mapping import load_kept_mask
from labrig.analysis.pictures import Analysis, Progress, concluded, look_at
from labrig.analysis.result import AnyResult, Stamp, load_result, result_numbers, write_result
from labrig.analysis.workers import DEFAULT_WORKERS
from labrig.errors import InputError, RecordError
from labrig.protocol.load import load_protocol
from labrig.protocol.sections import ExperimentProtocol
from labrig.record.reader import Run
from labrig.vision.mask import Mask


def analyze_run(
    run: Run,
    experiment: MeasuredExperiment,
    *,
    overrides: Sequence[str] = (),
    workers: int = DEFAULT_WORKERS,
    progress: Progress | None = None,
    created: datetime,
    provenance: Mapping[str, Any],
    mask: Mask | None = None,
) -> AnyResult:
    """Measure a run, or study the design that it asks for, and write a new numbered result, `RUN/analysis/NNN/`.

    Parameters
    ----------
    experiment : MeasuredExperiment
        The experiment of the run.
    overrides : sequence of str
        `section.key=value` each, put over the protocol; kept in the result.
    workers : int
        Processes that measure or search. The result is the same for any number of them.
    progress : callable or None
        Called with how many pictures (of a design: hinges) are done, and how many there are.
    created : datetime
        Calendar time, aware.
    provenance : Mapping
        Code version, packages, host and command line, as `labrig.record.collect_provenance` gives them.
    mask : Mask or None
        Pixels that are not the needle; a copy is kept with the result. None: the run's own, where it keeps one.

    Raises
    ------
    InputError
        When an override is not of a section that may be changed, or the run has no map from pixels to mm.
    FileFormatError
        When an override cannot be used, or a calibration file of the run is malformed.
    RecordError
        When the run's lines are damaged.
    DiskError, MachineError
        When the result cannot be written, or a worker process dies.
    """
    analysis = analysis_of(
        run,
        experiment,
        overrides=overrides,
        created=created,
        provenance=provenance,
        mask=mask,
        workers=workers,
        progress=progress,
    )
    return concluded(analysis, lambda work: look_at(work, workers, progress))


def analysis_of(
    run: Run,
    experiment: MeasuredExperiment,
    *,
    overrides: Sequence[str],
    created: datetime,
    provenance: Mapping[str, Any],
    mask: Mask | None,
    workers: int,
    progress: Progress | None,
) -> Analysis[AnyResult]:
    """Give the analysis of a run, which asks for the pictures that it wants to be measured; as `analyze_run`."""
    if run.withdraws is not None:
        raise InputError(
            f"{run.path} is the withdrawal of the needle of run {run.withdraws}; it has no pictures to measure",
            f"labrig reanalyze {run.path.parent / run.withdraws}",
        )
    protocol = _resolved_protocol(run, experiment, overrides)
    stamp = Stamp(
        parent=_parent(run, experiment),
        created=created.isoformat(timespec="seconds"),
        overrides=tuple(overrides),
        inputs=_input_hashes(run.path),
        provenance=dict(provenance),
        damage={problem.where: problem.message for problem in run.damage},
    )
    request = AnalysisRequest(stamp, load_kept_mask(run) if mask is None else mask, workers, progress)
    found = experiment.analyze(run, protocol, request)
    findings = (yield from found) if isinstance(found, Generator) else found
    # The folder is made once there is something to put into it: an analysis that fails leaves nothing behind.
    return write_result(run.new_result_dir(), findings)


def _parent(run: Run, experiment: MeasuredExperiment) -> int | None:
    """Return the number of the newest result with the run's own settings; else of the newest that can be read."""
    readable: list[int] = []
    for number in reversed(result_numbers(run)):
        with suppress(RecordError):
            result = load_result(run, experiment.result_model, number)
            readable.append(number)
            if result is not None and _has_own_settings(result):
                return number
    return readable[0] if readable else None


def _has_own_settings(result: AnyResult) -> bool:
    return not result.content.overrides and "mask" not in result.content.settings


def _resolved_protocol(
    run: Run, experiment: MeasuredExperiment, overrides: Sequence[str]
) -> ExperimentProtocol:
    """Return the run's protocol with the overrides on it; only how it is measured can be changed."""
    sections = experiment.reanalysis_keys
    for override in overrides:
        section = override.partition("=")[0].partition(".")[0]
        if section not in sections or not override.startswith(f"{section}."):
            raise InputError(
                f"{override!r} cannot be changed after the run: {_changeable(sections)}",
                _example(section, experiment) if sections else "run its protocol again",
            )
    return load_protocol(run.protocol_path, {experiment.name: experiment.protocol_model}, overrides)


def _changeable(sections: Sequence[str]) -> str:
    return f"only {', '.join(f'{section}.*' for section in sections)} can" if sections else "nothing can"


def _example(section: str, experiment: MeasuredExperiment) -> str:
    """Return what was probably meant, and a key that can be changed."""
    near = get_close_matches(section, experiment.reanalysis_keys, 1)
    meant = f"did you mean {near[0]}.? " if near else ""
    first = experiment.reanalysis_keys[0]
    model = experiment.protocol_model.model_fields[first].annotation
    keys = getattr(model, "model_fields", {})
    return f"{meant}for example {first}.{next(iter(keys), 'key')}=VALUE"


def _input_hashes(path: Path) -> dict[str, str]:
    """Return the SHA-256 of each file that the result rests on; frames.jsonl holds those of the pictures."""
    files = [path / name for name in ("protocol.yaml", "frames.jsonl", "events.jsonl", "truth.jsonl")]
    files += sorted((path / "calibration").glob("*.json"))
    return {
        file.relative_to(path).as_posix(): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in files
        if file.is_file()
    }
