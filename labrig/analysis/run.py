"""From a run to its result: the one door."""

import hashlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from labrig.analysis.calibration import analyze_calibration
from labrig.analysis.curvature import analyze_curvature
from labrig.analysis.design import analyze_design
from labrig.analysis.insertion import analyze_insertion
from labrig.analysis.mapping import load_kept_mask
from labrig.analysis.pictures import Analysis, Progress, concluded, look_at
from labrig.analysis.result import AnalysisResult, Stamp, load_result, result_numbers, write_result
from labrig.analysis.roll_zero import analyze_roll_zero
from labrig.analysis.workers import DEFAULT_WORKERS
from labrig.errors import InputError, RecordError
from labrig.protocol.insertion import InsertionProtocol, RollZeroProtocol
from labrig.protocol.load import AnyProtocol, load_protocol
from labrig.protocol.protocols import (
    CameraCalibrationProtocol,
    DesignProtocol,
    ImportProtocol,
    SteerabilityProtocol,
)
from labrig.record.durable import write_atomically
from labrig.record.reader import Run
from labrig.vision.mask import Mask

BY_PICTURES = (SteerabilityProtocol, ImportProtocol, RollZeroProtocol)
"""Protocols whose analysis is made of pictures that can be measured one by one, in any process."""

_OVERRIDABLE = ("analysis.",)
# How an insertion was steered can be asked of its pictures again; see `labrig.analysis.insertion`.
_OVERRIDABLE_IN_INSERTIONS = ("estimator.", "planner.", "policy.")


def analyze_run(
    run: Run,
    *,
    overrides: Sequence[str] = (),
    workers: int = DEFAULT_WORKERS,
    progress: Progress | None = None,
    created: datetime,
    provenance: Mapping[str, Any],
    mask: Mask | None = None,
) -> AnalysisResult:
    """Measure a run, or study the design that it asks for, and write a new numbered result, `RUN/analysis/NNN/`.

    Parameters
    ----------
    overrides : sequence of str
        `analysis.key=value` each, put over the protocol's analysis section; kept in the result.
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
        When an override is not of the analysis section, or the run has no map from pixels to mm.
    FileFormatError
        When an override cannot be used, or a calibration file of the run is malformed.
    RecordError
        When the run's lines are damaged.
    DiskError, MachineError
        When the result cannot be written, or a worker process dies.
    """
    analysis = analysis_of(run, overrides, created, provenance, mask, workers=workers, progress=progress)
    return concluded(analysis, lambda work: look_at(work, workers, progress))


def analysis_of(
    run: Run,
    overrides: Sequence[str],
    created: datetime,
    provenance: Mapping[str, Any],
    mask: Mask | None,
    *,
    workers: int,
    progress: Progress | None,
) -> Analysis[AnalysisResult]:
    """Give the analysis of a run, which asks for the pictures that it wants to be measured; as `analyze_run`."""
    if run.withdraws is not None:
        raise InputError(
            f"{run.path} is the withdrawal of the needle of run {run.withdraws}; it has no pictures to measure",
            f"labrig reanalyze {run.path.parent / run.withdraws}",
        )
    protocol = _resolved_protocol(run, overrides)
    stamp = Stamp(
        parent=_parent(run),
        created=created.isoformat(timespec="seconds"),
        overrides=tuple(overrides),
        inputs=_input_hashes(run.path),
        provenance=dict(provenance),
        damage={problem.where: problem.message for problem in run.damage},
    )
    mask = load_kept_mask(run) if mask is None else mask
    # The folder is made once there is something to put into it: an analysis that fails leaves nothing behind.
    if isinstance(protocol, CameraCalibrationProtocol):
        calibration = analyze_calibration(run, protocol, stamp, progress)
        folder = run.new_result_dir()
        calibration.save(folder)
        return write_result(folder, calibration.content)
    if isinstance(protocol, SteerabilityProtocol | ImportProtocol):
        content, lines = yield from analyze_curvature(run, protocol, stamp, mask)
        folder = run.new_result_dir()
        if mask is not None:
            write_atomically(folder / mask.kept_as, mask.content)
        return write_result(folder, content, lines)
    if isinstance(protocol, DesignProtocol):
        answer, study = analyze_design(protocol, stamp, workers, progress)
        folder = run.new_result_dir()
        study.save(folder, stamp.provenance)
        return write_result(folder, answer)
    if isinstance(protocol, InsertionProtocol):
        arrivals = analyze_insertion(run, protocol, stamp, mask, progress)
        return write_result(run.new_result_dir(), arrivals)
    if isinstance(protocol, RollZeroProtocol):
        zero = yield from analyze_roll_zero(run, protocol, stamp, mask)
        return write_result(run.new_result_dir(), zero)
    raise InputError(f"runs of the experiment {protocol.experiment!r} have no analysis", "use a newer labrig")


def _parent(run: Run) -> int | None:
    """Return the number of the newest result with the run's own settings; else of the newest that can be read."""
    readable: list[int] = []
    for number in reversed(result_numbers(run)):
        with suppress(RecordError):
            result = load_result(run, number)
            readable.append(number)
            if result is not None and _has_own_settings(result):
                return number
    return readable[0] if readable else None


def _has_own_settings(result: AnalysisResult) -> bool:
    return not result.content.overrides and "mask" not in result.content.settings


def _resolved_protocol(run: Run, overrides: Sequence[str]) -> AnyProtocol:
    """Return the run's protocol with the overrides on it; only how it is measured can be changed."""
    recorded = run.protocol
    prefixes = _OVERRIDABLE_IN_INSERTIONS if isinstance(recorded, InsertionProtocol) else _OVERRIDABLE
    for override in overrides:
        if not override.startswith(prefixes):
            example = (
                "policy.deviation_mm=1" if prefixes is not _OVERRIDABLE else "analysis.window_start_mm=5"
            )
            section = override.partition("=")[0].partition(".")[0]
            near = get_close_matches(section, [one.rstrip(".") for one in prefixes], 1)
            meant = f"did you mean {near[0]}.? " if near else ""
            raise InputError(
                f"{override!r} cannot be changed after the run: only {', '.join(f'{one}*' for one in prefixes)} can",
                f"{meant}for example {example}",
            )
    return load_protocol(run.path / "protocol.yaml", overrides) if overrides else recorded


def _input_hashes(path: Path) -> dict[str, str]:
    """Return the SHA-256 of each file that the result rests on; frames.jsonl holds those of the pictures."""
    files = [path / name for name in ("protocol.yaml", "frames.jsonl", "events.jsonl", "truth.jsonl")]
    files += sorted((path / "calibration").glob("*.json"))
    return {
        file.relative_to(path).as_posix(): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in files
        if file.is_file()
    }
