"""How what was computed again agrees with what is recorded, printed alike by `replay` and `reanalyze`."""

from textwrap import shorten
from typing import Any

from labrig.cli.output import print_line
from labrig.report.formatting import label_key

_VERDICTS = {
    "identical": "every decision and every number is the same",
    "equivalent": "the same decisions, and every number within its tolerance",
    "different": "a decision is another one, or a number is beyond its tolerance",
}
_MOST_QUANTITIES, _WIDEST = 3, 100


def print_agreement(found: Any, place: str, names: tuple[str, str]) -> None:
    """Print the first difference, both values under these names, and the verdict with the largest."""
    print_line(f"{found.verdict}: {_VERDICTS[found.verdict]}")
    first = found.first
    if first is not None:
        print_line(f"  first {place}: {label_key(first.path)}")
        for name, value in zip(names, (first.recorded, first.now), strict=True):
            shown = round(value, 6) if isinstance(value, float) else value
            print_line(f"  {name}: {shorten(str(shown), _WIDEST)}")
        if first.tolerance is not None:
            print_line(f"  they differ by {first.size:.3g}; {first.tolerance:.3g} is allowed")
    for quantity, share in sorted(found.shares.items(), key=lambda item: -item[1])[:_MOST_QUANTITIES]:
        size, in_sd = found.largest[quantity], found.in_sd.get(quantity)
        part = f"{share:.2g} of its tolerance" if in_sd is None else f"{in_sd:.2g} of its standard deviation"
        print_line(f"  largest difference of {label_key(quantity)}: {size:.2g}, {part}")
