"""How what was computed again agrees with what is recorded, printed alike by `replay` and `reanalyze`."""

from textwrap import shorten

from labrig.cli.output import print_line
from labrig.record.agreement import Agreement, Deviation, Verdict

_VERDICTS = {
    Verdict.IDENTICAL: "every decision and every number is the same",
    Verdict.EQUIVALENT: "the same decisions, and every number within its tolerance",
    Verdict.DIFFERENT: "a decision is another one, or a number is beyond its tolerance",
}
_MOST_QUANTITIES, _WIDEST = 3, 100


def print_verdict(agreement: Agreement) -> None:
    """Print the verdict."""
    print_line(f"{agreement.verdict}: {_VERDICTS[agreement.verdict]}")


def print_deviation(deviation: Deviation, place: str, names: tuple[str, str]) -> None:
    """Print the first decision, or number beyond its tolerance, with both values under these names."""
    print_line(f"  first {place}: {deviation.path}")
    for name, value in zip(names, (deviation.recorded, deviation.now), strict=True):
        print_line(f"  {name}: {shorten(str(value), _WIDEST)}")
    if deviation.tolerance is not None:
        print_line(f"  they differ by {deviation.size:.3g}; {deviation.tolerance:.3g} is allowed")


def print_largest(agreement: Agreement) -> None:
    """Print the quantities that come nearest to their tolerance, or are farthest beyond it."""
    by_share = sorted(agreement.shares.items(), key=lambda item: -item[1])
    for quantity, share in by_share[:_MOST_QUANTITIES]:
        size = agreement.largest[quantity]
        print_line(f"  largest difference of {quantity}: {size:.2g}, {100 * share:.2g} % of its tolerance")
    if len(by_share) > _MOST_QUANTITIES:
        print_line(
            f"  {len(by_share) - _MOST_QUANTITIES} other quantities differ by less of theirs; --json lists them"
        )
