"""`labrig campaign --certify RUN`: what would have to be wrong for an insertion to miss."""

import sys
from collections.abc import Sequence
from pathlib import Path

from labrig.analysis.certificate import Certificate, Margin, describe_half, write_certificate
from labrig.analysis.engine import run_in_order
from labrig.campaign.certificate import Found, certify, compute_repetition, make_certificate, prepare_repeat
from labrig.cli.damage import require_undamaged
from labrig.cli.output import print_json, print_line, print_table, say
from labrig.cli.progress import progress
from labrig.cli.worker_pool import open_pool
from labrig.devices.clocks import SystemClock
from labrig.experiments.registry import load_run_result
from labrig.record.provenance import collect_provenance
from labrig.record.reader import Run, open_run
from labrig.text import interval, number

_HEADS = (
    "assumed",
    "unit",
    "stated",
    "SD",
    "fewer than half arrive at",
    "surely between",
    "margin",
    "in SDs",
    "arrive there",
    "95 %",
)


def certify_run(
    path: Path, workers: int | None, cluster: str | None, repetitions: int, *, as_json: bool
) -> int:
    """Repeat a run virtually, and write its certificate and its page; when it is interrupted, nothing is written."""
    run = open_run(path, read_pictures=True)
    require_undamaged(
        path, run.damage, "only a run that is as it was written is certified; see: labrig runs check"
    )
    clock = SystemClock()
    found = _search(run, workers, cluster, repetitions, clock)
    say(f"{found.insertions} virtual insertions in {clock.now_s():.0f} s")
    provenance = collect_provenance(tuple(sys.argv))
    certificate = make_certificate(run, found, created=clock.utc(), provenance=provenance)
    file = write_certificate(run, certificate)
    report = _write_page(path)
    if as_json:
        print_json({**certificate.model_dump(mode="json"), "certificate": str(file), "report": str(report)})
    else:
        _print(certificate)
        print_line(f"certificate  {file}\nreport       {report}")
    return 0


def _search(
    run: Run, workers: int | None, cluster: str | None, repetitions: int, clock: SystemClock
) -> Found:
    """Search all margins, with progress."""
    repeat = prepare_repeat(run)
    with (
        open_pool(workers, cluster, "computed repetitions") as pool,
        progress(f"certifying {run.path.name}", 1.0) as reporter,
    ):

        def watch(done: int, left: int) -> None:
            reporter(done / (done + left), f"{done} virtual insertions, about {left} to go")

        return certify(
            repeat,
            lambda orders: run_in_order(pool, compute_repetition, orders, clock=clock),
            watch,
            repetitions=repetitions,
        )


def _write_page(path: Path) -> Path:
    """Write the page of the run again, with its newest result and the certificate."""
    # Imported late: the workers are forked before matplotlib is loaded, and stay small.
    from labrig.cli.reporting import write_page

    say("writing the report")
    run = open_run(path)
    return write_page(run, load_run_result(run))


def _print(certificate: Certificate) -> None:
    base = certificate.base
    share = interval([100 * limit for limit in base.share_ci95], 0)
    print_line(f"arrival: {certificate.arrival}")
    print_line(f"nothing wrong: {base.arrived} of {base.n} arrive, 95 % interval {share} %")
    for note in certificate.notes:
        print_line(note)
    if not certificate.margins:
        print_line("fewer than half arrive although nothing is wrong, so that no margin can be told")
        return
    print_table(_HEADS, [_make_row(margin) for margin in certificate.margins])
    print_line(
        "one assumption is turned at a time; what several that are wrong together do is not in this table"
    )
    for part in certificate.not_tried:
        print_line(f"not tried: {part.name}; {part.why}")


def _make_row(margin: Margin) -> Sequence[str]:
    missed, sign = margin.misses_at, "<" if margin.direction < 0 else ">"
    stated, sd = (_shorten(value) for value in (margin.stated, margin.sd))
    head, between = (margin.name, margin.unit, stated, sd), describe_half(margin, _shorten)
    if missed is None:
        return (*head, f"{sign} {_shorten(margin.farthest)}, the last tried", between, "-", "-", "-", "-")
    there = missed.arrivals
    return (
        *head,
        _shorten(missed.value),
        between,
        _shorten(margin.margin),
        number(margin.margin_sds, 1),
        f"{there.arrived} of {there.n}",
        interval([100 * limit for limit in there.share_ci95], 0),
    )


def _shorten(value: float | None) -> str:
    """Return a value with three digits; a dash if there is none."""
    return "-" if value is None else f"{value:.3g}"
