"""`labrig replay`: runs the procedure again with the recorded answers, and compares what it asks."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from labrig.cli.agreement import print_deviation, print_largest, print_verdict
from labrig.cli.options import RunArgument
from labrig.cli.output import AsJson, print_json, print_line
from labrig.errors import AnswerIsNoError
from labrig.record.agreement import Agreement, Verdict
from labrig.record.processor import describe_change
from labrig.record.provenance import collect_provenance


def replay(
    run_path: RunArgument,
    as_json: AsJson = False,
) -> int:
    """Exit with 0 if the procedure decides the same again and its numbers agree, and with 1 if it does not."""
    from labrig.cli.attendant import TerminalAttendant
    from labrig.library import door

    run = door.open_run(run_path)
    found = door.replay(run, attendant=TerminalAttendant())
    difference, place = found.first_difference, found.place
    document = {
        "run": str(run_path),
        "verdict": str(found.verdict),
        "identical": found.verdict is Verdict.IDENTICAL,
        "first_difference": None
        if difference is None or place is None
        else {**asdict(difference), **asdict(place), "went_on": not found.stopped},
        "beyond": found.agreement.beyond,
        "largest": found.agreement.largest,
        "ended_early": found.ended_early or None,
        "compared": found.counts,
        "explained_by": _explain(run.manifest.get("provenance"), found.verdict),
    }
    if as_json:
        print_json(document)
    else:
        _print(document, found.agreement)
    return AnswerIsNoError.exit_code if found.verdict is Verdict.DIFFERENT else 0


def _print(document: Mapping[str, Any], agreement: Agreement) -> None:
    """Print the verdict, the first difference with both values, the largest ones, and what was compared."""
    print_verdict(agreement)
    place = document["first_difference"]
    if agreement.first is not None and place is not None:
        trial = None if place["trial"] is None else place["trial"] + 1
        where = f"after picture {_format(place['frame'])}, in trial {_format(trial)}"
        where = f"at t = {place['t_s']:.3f} s, {where}"
        print_deviation(agreement.first, where, ("in the record", "in the replay"))
        if not place["went_on"]:
            print_line("  the replay ends there: the record has no answer to what is asked now")
        elif agreement.beyond > 1:
            print_line(f"  to the end {agreement.beyond} values differ by more than is allowed")
    print_largest(agreement)
    for sentence in document["explained_by"]:
        print_line(f"  {sentence}")
    if document["ended_early"]:
        print_line(f"  {document['ended_early']}; it is compared up to there")
    same = ", ".join(f"{count} {what}" for what, count in document["compared"].items())
    print_line(f"  compared: {same or 'nothing'}")


def _explain(provenance: object, verdict: Verdict) -> list[str]:
    """Return what may explain a difference, as sentences: other code, another processor."""
    if verdict is Verdict.IDENTICAL:
        return []
    recorded = provenance if isinstance(provenance, Mapping) else {}
    now = collect_provenance(())
    sentences = [describe_change(recorded.get("processor"), now["processor"])]
    if any(recorded.get(key) != now[key] for key in ("labrig", "source_sha256")):
        sentences.insert(
            0, f"other code made this record: {_describe_code(recorded)}; this is {_describe_code(now)}"
        )
    return [sentence for sentence in sentences if sentence]


def _describe_code(provenance: Mapping[str, Any]) -> str:
    commit = str(provenance.get("git_commit") or provenance.get("source_sha256") or "of no commit")[:12]
    changed = " with changes" if provenance.get("git_dirty") else ""
    return f"labrig {_format(provenance.get('labrig'))}, {commit}{changed}"


def _format(number: object) -> str:
    return "none" if number is None else str(number)
