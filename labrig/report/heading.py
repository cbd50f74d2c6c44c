"""The head of every page: title, operator, ending, and damage of the record."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from markupsafe import Markup

from labrig import __version__
from labrig.analysis.result import AnyResult
from labrig.errors import RecordError
from labrig.record.events import INCOMPLETE, INTERRUPTED, RecordedTrial, TrialStart, TrialStop
from labrig.record.manifest import is_simulated
from labrig.record.reader import Run
from labrig.report.decisions import list_decisions
from labrig.report.formatting import UNKNOWN, Rows, format_time, format_value
from labrig.text import format_count

_STATUS_WORDS = {"success": "complete", "aborted": "aborted", "failed": "failed", "incomplete": "incomplete"}


@dataclass(frozen=True)
class Heading:
    """Title, status and facts of a run; `verdict` summarises the page in a sentence or two.

    `status` is that of the run, or the operator's verdict on a complete run: doubtful or bad.

    `annotations` are tags, verdict and notes, each with a heading; `decisions` are what a person did during the run,
    each with its time; `problems` are the faults of the record now (place, message, hint), `damage` further faults when
    it was measured.
    """

    eyebrow: str
    title: str
    run_name: str
    status: str
    status_word: str
    simulated: bool
    recorded_pictures: bool
    verdict: tuple[str, ...]
    facts: tuple[tuple[str, str], ...]
    notes: str
    annotations: tuple[tuple[str, str], ...]
    decisions: tuple[tuple[str, str], ...]
    written: str
    problems: tuple[tuple[str, str, str], ...]
    damage: tuple[str, ...]


def make_heading(
    run: Run,
    verdict: Sequence[str],
    created: datetime,
    result: AnyResult | None = None,
    *,
    kind: str,
    facts: Rows = (),
    can_resume: bool = False,
) -> Heading:
    """Return the head of a page with this verdict, based on `result`.

    Parameters
    ----------
    kind : str
        Title of the experiment.
    facts : tuple
        Terms and values of its protocol.
    can_resume : bool
        Whether an interrupted run can be continued.
    """
    problems = tuple((problem.where, problem.message, problem.hint) for problem in run.damage)
    known = {f"{where}: {message}" for where, message, _ in problems}
    measured = () if result is None else result.content.damage
    status = str(run.manifest.get("exit_status", "incomplete"))
    judged = _find_judgement(run)
    word = _STATUS_WORDS.get(status, status)
    return Heading(
        eyebrow=kind,
        title=str(run.protocol.get("title") or run.path.name),
        run_name=run.path.name,
        status=judged if judged is not None and status == "success" else status,
        status_word=word if judged is None else f"{word}, judged {judged}",
        simulated=_is_simulated(run),
        recorded_pictures=_has_recorded_pictures(run),
        verdict=(
            *_describe_ending(run, status),
            *_warn_of_needle(run, status),
            *_list_next_steps(run, status, can_resume=can_resume),
            *_describe_result(run, result),
            *verdict,
        ),
        facts=tuple((term, value) for term, value in _list_facts(run, facts) if value != UNKNOWN),
        notes=str(run.protocol.get("notes") or "").strip(),
        annotations=_list_annotations(run),
        decisions=list_decisions(run),
        written=f"Written {format_time(created.isoformat(timespec='seconds'))} by labrig {__version__}",
        problems=problems,
        damage=tuple(fault for fault in measured if fault not in known),
    )


def _find_judgement(run: Run) -> str | None:
    """Return the operator's verdict if it is one against the run."""
    try:
        verdict = run.annotations.verdict
    except RecordError:  # the page says so under its annotations
        return None
    return verdict if verdict in {"doubtful", "bad"} else None


def _describe_result(run: Run, result: AnyResult | None) -> tuple[str, ...]:
    """Say which result is shown if it is not the newest, or was not measured with the run's own settings."""
    if result is None:
        return ()
    shown, newest = int(result.path.name), max(run.result_numbers, default=0)
    changed, sentences = result.content.overrides, []
    if shown < newest:
        sentences.append(f"Result {shown} is shown; the newest is {newest}.")
    if changed:
        others = Markup("<code>labrig report {} --result N</code>").format(shlex.quote(str(run.path)))
        told = Markup("Result {} was measured with settings changed after the run: {}. {} shows another.")
        sentences.append(told.format(shown, ", ".join(changed), others))
    return tuple(sentences)


def _list_annotations(run: Run) -> tuple[tuple[str, str], ...]:
    """Return verdict, tags and notes of a run, or the error if they cannot be read."""
    try:
        annotations = run.annotations
    except RecordError as error:
        return (("Notes", error.message.replace(f"{run.path}/", "")),)
    notes = [
        (", ".join(filter(None, (f"Note {number}", note.by, format_time(note.at)))), note.text)
        for number, note in enumerate(annotations.notes, start=1)
    ]
    rows = (("Verdict", annotations.verdict or ""), ("Tags", ", ".join(annotations.tags)), *notes)
    return tuple((term, text) for term, text in rows if text)


def _is_simulated(run: Run) -> bool:
    return not run.truth.empty or is_simulated(run.manifest)


def _has_recorded_pictures(run: Run) -> bool:
    """Return whether the pictures came from a film or a folder instead of a camera."""
    camera = run.devices.get("camera")
    return isinstance(camera, Mapping) and bool(camera.get("recorded_pictures"))


def _describe_ending(run: Run, status: str) -> tuple[str, ...]:
    """Describe the ending of a run that did not succeed."""
    if status == "success":
        return ()
    # Reasons for programs are words with underscores.
    recorded = str(run.manifest.get("reason") or "no reason was recorded")
    reason = recorded.rstrip(".").replace("_", " ")
    planned, done = run.manifest.get("trials_planned"), _count_ended_trials(run)
    made = (
        f" {done} of {format_count(planned, 'planned insertion')} ended."
        if isinstance(planned, int) and planned
        else ""
    )
    if status == "incomplete":
        return (f"The run was never closed: it is still going on, or it was killed.{made}",)
    return (f"The run {'was aborted' if status == 'aborted' else 'failed'}: {reason}.{made}",)


def _warn_of_needle(run: Run, status: str) -> tuple[str, ...]:
    """Warn of a run that stopped during an insertion, with the last reading of the axes."""
    trials = _read_trials(run)
    if status == "success" or not trials or trials[-1].stop is not None:
        return ()
    place = f"The needle may still be in tissue: the run stopped within trial {trials[-1].start.trial + 1}"
    if run.states.empty:
        return (f"{place}, and the axes were never read.",)
    axes = run.states.iloc[-1]
    return (
        f"{place}.",
        (
            f"At the last reading the insertion axis stood at {axes['insertion_mm']:.2f} mm "
            f"and the linear axis, which carries the sheath, at {axes['linear_mm']:.2f} mm."
        ),
    )


def _list_next_steps(run: Run, status: str, *, can_resume: bool) -> tuple[str, ...]:
    """Return the commands that withdraw a needle that may be in tissue, and that resume a run."""
    steps, place = [], shlex.quote(str(run.path))
    if not _is_simulated(run) and _warn_of_needle(run, status):
        withdraw = Markup("<code>labrig devices withdraw --rig FILE --run {}</code>").format(place)
        steps.append(Markup("Take it out along its path: {}.").format(withdraw))
    planned = run.manifest.get("trials_planned")
    remain = not isinstance(planned, int) or _count_ended_trials(run) < planned
    if status != "success" and can_resume and remain:
        steps.append(Markup("Go on with the run: <code>labrig resume {}</code>.").format(place))
    return tuple(steps)


def _count_ended_trials(run: Run) -> int:
    """Return how many trials ended by themselves, with any status."""
    return sum(trial.exit_status not in {INCOMPLETE, INTERRUPTED} for trial in _read_trials(run))


def _read_trials(run: Run) -> tuple[RecordedTrial[TrialStart, TrialStop], ...]:
    return run.read_trials(TrialStart, TrialStop)


def format_trials_done(run: Run) -> str:
    """Return the number of successful trials that are evaluated and the number planned."""
    done = sum(trial.exit_status == "success" and not trial.left_out for trial in _read_trials(run))
    return f"{done} of {format_value(run.manifest.get('trials_planned'))}"


def _list_facts(run: Run, facts: Rows) -> list[tuple[str, str]]:
    manifest = run.manifest
    return [
        ("Run", run.path.name),
        ("Operator", format_value(run.protocol.get("operator"))),
        ("Started", format_time(manifest.get("started"))),
        ("Ended", format_time(manifest.get("ended"))),
        *_describe_sessions(run),
        *facts,
        ("Pictures recorded", _count_pictures(run)),
        ("Seed", format_value(manifest.get("seed"))),
        ("Checksum of the record, for a notebook", run.checksum or UNKNOWN),
    ]


def _describe_sessions(run: Run) -> list[tuple[str, str]]:
    """Return how often a run was resumed; nothing if it was not."""
    times = len(run.sessions)
    return [("Resumed", "once" if times == 1 else f"{times} times")] if times else []


def _count_pictures(run: Run) -> str:
    """Return the number of pictures; unknown for a run that takes none."""
    takes_some = run.rig_path is not None or bool(run.frame_lines)
    return str(len(run.frame_lines)) if takes_some else UNKNOWN
