"""What came of one task of a campaign: a virtual run, a whole run on a simulated rig, or the analysis of a record."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class TaskOutcome:
    """What came of one task: how it ended, and its quantities.

    Attributes
    ----------
    exit_status : str
        success, failed or aborted, as in the manifest of a run.
    reason : str or None
        As in the manifest, such as target_missed or blocked; None for a success.
    values : mapping of str to float, int, bool, str or None
        Quantities by name, units in the names; None where one has no value.
    """

    exit_status: str
    reason: str | None
    values: Mapping[str, float | int | bool | str | None]
