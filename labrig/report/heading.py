"""The head of every page: what was done, by whom, how it ended, and whether the record is whole."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from markupsafe import Markup

from labrig import __version__
from labrig.analysis.result import AnyResult
from labrig.errors import RecordError
from labrig.record.events import INCOMPLETE, INTERRUPTED, RecordedTrial, TrialStart, TrialStop
from labrig.record.reader import Run
from labrig.report.words import UNKNOWN, Rows, count_of, moment, shown

_STATUS_WORDS = {"success": "complete", "aborted": "aborted", "failed": "failed", "incomplete": "incomplete"}


@dataclass(frozen=True)
class Heading:
    """Title, state and facts of a run; `verdict` is the page in a sentence or two.

    `said` is what people say of the run (tags, verdict and notes, each with a heading), `problems` what the record
    lacks now (where, what, what to do), `damage` what else it lacked when it was measured.
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
    said: tuple[tuple[str, str], ...]
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
    """Return the head of a page whose body says `verdict` in a sentence or two, and rests on `result`.

    Parameters
    ----------
    kind : str
        What the experiment is called.
    facts : tuple
        What it says of its protocol.
    can_resume : bool
        Whether an interrupted run can be continued.
    """
    problems = tuple((problem.where, problem.message, problem.hint) for problem in run.problems)
    known = {f"{where}: {message}" for where, message, _ in problems}
    measured = () if result is None else result.content.damage
    status = str(run.manifest.get("exit_status", "incomplete"))
    return Heading(
        eyebrow=kind,
        title=str(run.protocol.get("title") or run.path.name),
        run_name=run.path.name,
        status=status,
        status_word=_STATUS_WORDS.get(status, status),
        simulated=_is_simulated(run),
        recorded_pictures=_has_recorded_pictures(run),
        verdict=(
            *_how_it_ended(run, status),
            *_where_the_needle_is(run, status),
            *_what_next(run, status, can_resume=can_resume),
            *verdict,
        ),
        facts=tuple((term, value) for term, value in _facts(run, facts) if value != UNKNOWN),
        notes=str(run.protocol.get("notes") or "").strip(),
        said=_said(run),
        written=f"Written {moment(created.isoformat(timespec='seconds'))} by labrig {__version__}",
        problems=problems,
        damage=tuple(one for one in measured if one not in known),
    )


def _said(run: Run) -> tuple[tuple[str, str], ...]:
    """Return what people have said of a run since; of notes that cannot be read that they cannot be."""
    try:
        said = run.annotations
    except RecordError as error:
        return (("Notes", error.message.replace(f"{run.path}/", "")),)
    verdict = ": ".join(filter(None, (said.verdict, said.verdict_reason)))
    notes = [(f"Note {one.note}, {one.by}, {moment(one.at)}", one.text) for one in said.notes]
    rows = (("Verdict", verdict), ("Tags", ", ".join(said.tags)), *notes)
    return tuple((term, text) for term, text in rows if text)


def _is_simulated(run: Run) -> bool:
    devices = run.manifest.get("devices")
    return not run.truth.empty or (isinstance(devices, Mapping) and devices.get("kind") == "simulated")


def _has_recorded_pictures(run: Run) -> bool:
    """Return whether the run took its pictures from a film or a folder, and not from a camera."""
    devices = run.manifest.get("devices")
    camera = devices.get("camera") if isinstance(devices, Mapping) else None
    return isinstance(camera, Mapping) and bool(camera.get("recorded_pictures"))


def _how_it_ended(run: Run, status: str) -> tuple[str, ...]:
    """Return what has to be said of a run that did not come to its end; nothing of one that did."""
    if status == "success":
        return ()
    # Reasons that programs read are words with underscores.
    reason = str(run.manifest.get("reason") or "no reason was recorded").rstrip(".").replace("_", " ")
    planned, done = run.manifest.get("trials_planned"), _trials_ended(run)
    made = (
        f" {done} of {count_of(planned, 'planned insertion')} ended."
        if isinstance(planned, int) and planned
        else ""
    )
    if status == "incomplete":
        return (f"The run was never closed: it is still going on, or it was killed.{made}",)
    return (f"The run {'was aborted' if status == 'aborted' else 'failed'}: {reason}.{made}",)


def _where_the_needle_is(run: Run, status: str) -> tuple[str, ...]:
    """Return a warning of a run that stopped within an insertion, with the last reading of the axes."""
    trials = _trials(run)
    if status == "success" or not trials or trials[-1].stop is not None:
        return ()
    place = f"The needle may still be in tissue: the run stopped within trial {trials[-1].start.trial}"
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


def _what_next(run: Run, status: str, *, can_resume: bool) -> tuple[str, ...]:
    """Return the commands that take a needle out which may be in tissue, and go on with a sweep."""
    steps, place = [], shlex.quote(str(run.path))
    if not _is_simulated(run) and _where_the_needle_is(run, status):
        withdraw = Markup("<code>labrig devices withdraw --rig FILE --run {}</code>").format(place)
        steps.append(Markup("Take it out along its path: {}.").format(withdraw))
    if status != "success" and can_resume:
        steps.append(Markup("Go on with the sweep: <code>labrig resume {}</code>.").format(place))
    return tuple(steps)


def _trials_ended(run: Run) -> int:
    """Return how many came to an end of their own, whatever it was."""
    return sum(trial.exit_status not in {INCOMPLETE, INTERRUPTED} for trial in _trials(run))


def _trials(run: Run) -> tuple[RecordedTrial[TrialStart, TrialStop], ...]:
    return run.read_trials(TrialStart, TrialStop)


def trials_done(run: Run) -> str:
    """Return how many trials came to their end, of how many that were planned."""
    done = sum(trial.exit_status == "success" for trial in _trials(run))
    return f"{done} of {shown(run.manifest.get('trials_planned'))}"


def _facts(run: Run, facts: Rows) -> list[tuple[str, str]]:
    manifest = run.manifest
    return [
        ("Run", run.path.name),
        ("Operator", shown(run.protocol.get("operator"))),
        ("Started", moment(manifest.get("started"))),
        ("Ended", moment(manifest.get("ended"))),
        *_resumed(run),
        *facts,
        ("Pictures recorded", _pictures(run)),
        ("Seed", shown(manifest.get("seed"))),
    ]


def _resumed(run: Run) -> list[tuple[str, str]]:
    """Say how often a run was resumed; nothing of one that was not."""
    times = len(run.sessions)
    return [("Resumed", "once" if times == 1 else f"{times} times")] if times else []


def _pictures(run: Run) -> str:
    """Return how many pictures there are; unknown of a run that takes none."""
    takes_some = run.rig_path is not None or bool(run.frame_lines)
    return str(len(run.frame_lines)) if takes_some else UNKNOWN
