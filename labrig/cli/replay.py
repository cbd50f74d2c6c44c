"""`labrig replay`: runs the procedure on recorded devices, and compares it with the record."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from labrig.cli.damage import require_undamaged
from labrig.cli.options import RunArgument
from labrig.cli.output import AsJson, print_json, print_line
from labrig.cli.progress import progress
from labrig.errors import AnswerIsNoError
from labrig.record.provenance import collect_provenance


def replay(
    run_path: RunArgument,
    as_json: AsJson = False,
) -> int:
    """Exit with 0 when every command and every line equals the record, and with 1 at the first difference.

    Where a change of labrig explains the difference, its sentence of the changelog is named.
    """
    from labrig.experiments.registry import find_run_experiment, load_run_protocol
    from labrig.record.reader import open_run
    from labrig.runner.replay import replay_run, replay_work

    run = open_run(run_path, read_pictures=True)
    require_undamaged(run.path, run.damage)
    experiment, protocol = find_run_experiment(run), load_run_protocol(run)
    with progress(f"replaying {run_path.name}", replay_work(run, experiment, protocol)) as reporter:
        found = replay_run(run, experiment, protocol, reporter)
    difference, change = found.first_difference, found.known_change
    document = {
        "run": str(run_path),
        "identical": found.identical,
        "first_difference": None if difference is None else asdict(difference),
        "known_change": None
        if change is None
        else {"version": change.version, "changelog": change.changelog},
        "bit_exact": found.bit_exact,
        "ended_early": found.ended_early or None,
        "compared": found.counts,
        "code": {"recorded": _code(run.manifest.get("provenance")), "now": _code(collect_provenance(()))},
    }
    if as_json:
        print_json(document)
    else:
        _print(document)
    return 0 if found.identical else AnswerIsNoError.exit_code


def _print(document: Mapping[str, Any]) -> None:
    """Print that the replay is identical, or the first difference with both values, and what was compared."""
    difference = document["first_difference"]
    if difference is None:
        print_line("identical, to the last bit" if document["bit_exact"] else "identical")
    else:
        place = f"after picture {_format(difference['frame'])}, in trial {_format(difference['trial'])}"
        print_line(f"differs at t = {difference['t_s']:.3f} s, {place}")
        print_line(f"  {difference['what']} in the record: {difference['recorded']}")
        print_line(f"  {difference['what']} in the replay: {difference['now']}")
        _print_code(document["code"])
        _print_change(document["known_change"])
    if document["ended_early"]:
        print_line(f"  {document['ended_early']}; it is compared up to there")
    same = ", ".join(f"{count} {what}" for what, count in document["compared"].items())
    print_line(f"  the same: {same or 'nothing before it'}")


def _code(provenance: object) -> dict[str, object]:
    """Return which code made a record, if its provenance holds that."""
    values = provenance if isinstance(provenance, Mapping) else {}
    return {key: values.get(key) for key in ("labrig", "git_commit", "git_dirty", "source_sha256")}


def _print_code(code: Mapping[str, Mapping[str, object]]) -> None:
    """Print both versions, if other code than this made the record."""
    recorded, now = code["recorded"], code["now"]
    if recorded != now or now["git_dirty"]:
        print_line(
            f"  other code made this record: {_describe_code(recorded)}; this is {_describe_code(now)}"
        )


def _print_change(change: Mapping[str, str] | None) -> None:
    """Print which line of the changelog explains the difference, or that none is known to."""
    if change is None:
        print_line("  no known change of labrig explains this difference: look into it")
        return
    print_line(
        f"  this difference is known, and what comes after it is not compared. Changelog, {change['version']}:"
    )
    print_line(f"  {change['changelog']}")


def _describe_code(code: Mapping[str, object]) -> str:
    commit = str(code["git_commit"] or code["source_sha256"] or "of no commit")[:12]
    return f"labrig {_format(code['labrig'])}, {commit}{' with changes' if code['git_dirty'] else ''}"


def _format(number: object) -> str:
    return "none" if number is None else str(number)
