"""What a roll zero run came to, as a sentence."""

import math

from markupsafe import Markup

from labrig.analysis import RollZeroResult


def roll_zero_verdict(result: RollZeroResult) -> list[Markup]:
    """Return the roll zero with its uncertainty, or why there is none."""
    if not result.accepted or result.fit is None:
        return [Markup("Not certified: {}.").format("; ".join(result.reasons))]
    zero, sd = math.degrees(result.fit["zero_rad"]), math.degrees(result.fit["sd_rad"])
    return [
        Markup(
            "Needle {} bends towards -y where the rotation axis stands at {:.2f} ± {:.2f} degrees."
        ).format(result.needle_id, zero, sd)
    ]
