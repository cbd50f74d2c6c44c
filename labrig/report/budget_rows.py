"""Where the error bars of a result come from, as rows of its page."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labrig.vision.error_budget import ErrorBudget

_MEANINGS = {
    "lens": "calibration of the lens",
    "plane": "map of the plane: the paper's lines and bend, and the camera's drift",
    "surface": "the gel's surface, and glass before it",
    "roll": "angle between the needle's plane and the map's",
    "lighting": "uneven light on the needle's two edges",
    "fit": "scatter of the edges; the reading of an end",
}


@dataclass(frozen=True)
class BudgetRow:
    """A source of error: what it is, and its median standard deviation [mm] for each quantity, None if not known.

    `largest` says for each quantity whether no known source is larger.
    """

    source: str
    meaning: str
    sigmas_mm: tuple[float | None, ...]
    largest: tuple[bool, ...]


def list_budget_rows(quantities: Sequence[Sequence[ErrorBudget | None]]) -> list[BudgetRow]:
    """Return a row for each source, over the budgets of each quantity; none if no measurement has a budget."""
    known = [[budget for budget in budgets if budget is not None] for budgets in quantities]
    if not any(known):
        return []
    medians = [_average(budgets) for budgets in known]
    return [
        BudgetRow(
            name,
            _MEANINGS[name],
            tuple(getattr(median, name) for median in medians),
            tuple(median.largest == name for median in medians),
        )
        for name in ErrorBudget.model_fields
    ]


def _average(budgets: Sequence[ErrorBudget]) -> ErrorBudget:
    """Return the median of each source over the budgets that know it."""
    sigmas = {
        name: [value for value in (getattr(budget, name) for budget in budgets) if value is not None]
        for name in ErrorBudget.model_fields
    }
    return ErrorBudget(
        **{name: float(np.median(values)) if values else None for name, values in sigmas.items()}
    )
