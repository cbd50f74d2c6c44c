"""`labrig replay`: runs the procedure again with the recorded answers, and compares what it asks."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from labrig.cli.agreement import print_agreement
from labrig.cli.options import RunArgument
from labrig.cli.output import print_json, print_line


def replay(run_path: RunArgument) -> int:
    """Exit with 0 if the procedure decides the same again and its numbers agree, and with 1 if it does not."""
    from labrig.cli.attendant import TerminalAttendant
    from labrig.library import door

    run = door.open_run(run_path)
    found = door.replay(run, attendant=TerminalAttendant())
    difference, place, beyond = found.first_difference, found.place, found.agreement.beyond
    explained_by = [] if found.verdict == "identical" else _explain(run.manifest.get("provenance"))
    first: dict[str, object] | None = None
    where = ""
    if difference is not None and place is not None:
        first = {**asdict(difference), **asdict(place), "went_on": not found.stopped}
        trial = None if place.trial is None else place.trial + 1
        where = f"at t = {place.t_s:.3f} s, after picture {_format(place.frame)}, in trial {_format(trial)}"
    print_json({
        "run": str(run_path),
        "verdict": str(found.verdict),
        "identical": found.verdict == "identical",
        "first_difference": first,
        "beyond": beyond,
        "largest": found.agreement.largest,
        "ended_early": found.ended_early or None,
        "compared": found.counts,
        "explained_by": explained_by,
    })  # fmt: skip
    print_agreement(found.agreement, where, ("in the record", "in the replay"))
    if first is not None and found.stopped:
        print_line("  the replay ends there: the record has no answer to what is asked now")
    elif beyond > 1:
        print_line(f"  to the end {beyond} values differ by more than is allowed")
    for sentence in explained_by:
        print_line(f"  {sentence}")
    if explained_by and found.verdict == "different":
        print_line(
            f"  if that change was wanted, this shows its results beside the old: labrig reanalyze {run_path}"
        )
    if found.ended_early:
        print_line(f"  {found.ended_early}; it is compared up to there")
    same = ", ".join(f"{count} {what}" for what, count in found.counts.items())
    print_line(f"  compared, up to the last event: {same or 'nothing'}")
    return 1 if found.verdict == "different" else 0


def _explain(provenance: object) -> list[str]:
    """Return what may explain a difference, as sentences: other code, another processor."""
    from labrig.record.provenance import collect_provenance, describe_change

    recorded, now = provenance if isinstance(provenance, Mapping) else {}, collect_provenance(())
    is_other = any(recorded.get(key) != now[key] for key in ("labrig", "source_sha256"))
    made_by = f"other code made this record: {_describe_code(recorded)}; this is {_describe_code(now)}"
    sentences = (made_by if is_other else "", describe_change(recorded.get("processor"), now["processor"]))
    return [sentence for sentence in sentences if sentence]


def _describe_code(provenance: Mapping[str, Any]) -> str:
    commit = str(provenance.get("git_commit") or provenance.get("source_sha256") or "of no commit")[:12]
    changed = " with changes" if provenance.get("git_dirty") else ""
    return f"labrig {_format(provenance.get('labrig'))}, {commit}{changed}"


def _format(number: object) -> str:
    return "none" if number is None else str(number)
