"""What an insertion run, and a roll zero run, came to, as sentences."""

import math

from markupsafe import Markup

from labrig.analysis import InsertionResult, InsertionTrial, RollZeroResult
from labrig.report.words import number


def arrival_verdict(result: InsertionResult | RollZeroResult) -> list[Markup]:
    """Return what either kind of run came to."""
    return _insertions(result) if isinstance(result, InsertionResult) else _roll_zero(result)


def _insertions(result: InsertionResult) -> list[Markup]:
    """Return how many insertions arrived, and each one's error and cause."""
    first = Markup("{} of {} insertions reached the target.").format(result.arrived, result.made)
    return [first, *(_trial(one) for one in result.insertions)]


def _trial(one: InsertionTrial) -> Markup:
    return Markup(
        "Insertion {}: {} ({}). Measured {} mm from the target after {} mm, planned anew {} times; true error {} mm, "
        "true clearance {} mm."
    ).format(
        one.trial + 1,
        one.outcome,
        one.cause,
        number(one.target_error_mm),
        number(one.length_mm, 1),
        one.replans,
        number(one.true_target_error_mm),
        number(one.true_min_clearance_mm),
    )


def _roll_zero(result: RollZeroResult) -> list[Markup]:
    """Return the roll zero with its uncertainty, or why there is none."""
    if not result.accepted or result.fit is None:
        return [Markup("Not certified: {}.").format("; ".join(result.reasons))]
    zero, sd = math.degrees(result.fit["zero_rad"]), math.degrees(result.fit["sd_rad"])
    return [
        Markup(
            "Needle {} bends towards -y where the rotation axis stands at {:.2f} ± {:.2f} degrees."
        ).format(result.needle_id, zero, sd)
    ]
