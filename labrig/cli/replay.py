"""`labrig replay`: the same procedure on recorded devices, and whether it does what it did."""

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
    """Exit with 0 when every command and every line is the recorded one, and with 1 at the first that differs."""
    from labrig.experiments.registry import experiment_of, protocol_of
    from labrig.record.reader import open_run
    from labrig.runner.replay import replay_run, replay_work

    run = open_run(run_path)
    require_undamaged(run)
    experiment, protocol = experiment_of(run), protocol_of(run)
    with progress(f"replaying {run_path.name}", replay_work(run, experiment, protocol)) as reporter:
        found = replay_run(run, experiment, protocol, reporter)
    difference = found.first_difference
    document = {
        "run": str(run_path),
        "identical": found.identical,
        "first_difference": None if difference is None else asdict(difference),
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
    """Print whether all was the same, and what was compared; or the first difference with both values."""
    one = document["first_difference"]
    if one is None:
        print_line("identical, to the last bit" if document["bit_exact"] else "identical")
    else:
        place = f"after picture {_known(one['frame'])}, in trial {_known(one['trial'])}"
        print_line(f"differs at t = {one['t_s']:.3f} s, {place}")
        print_line(f"  {one['what']} in the record: {one['recorded']}")
        print_line(f"  {one['what']} in the replay: {one['now']}")
        _print_code(document["code"])
    if document["ended_early"]:
        print_line(f"  {document['ended_early']}; it is compared up to there")
    same = ", ".join(f"{count} {what}" for what, count in document["compared"].items())
    print_line(f"  the same: {same or 'nothing before it'}")


def _code(provenance: object) -> dict[str, object]:
    """Return which code made a record, as far as its provenance says."""
    said = provenance if isinstance(provenance, Mapping) else {}
    return {key: said.get(key) for key in ("labrig", "git_commit", "git_dirty")}


def _print_code(code: Mapping[str, Mapping[str, object]]) -> None:
    """Say whose difference it is, where other code than this one made the record."""
    recorded, now = code["recorded"], code["now"]
    if recorded != now or now["git_dirty"]:
        print_line(f"  other code made this record: {_named(recorded)}; this is {_named(now)}")


def _named(code: Mapping[str, object]) -> str:
    commit = str(code["git_commit"] or "of no commit")[:12]
    return f"labrig {_known(code['labrig'])}, {commit}{' with changes' if code['git_dirty'] else ''}"


def _known(number: object) -> str:
    return "none" if number is None else str(number)
