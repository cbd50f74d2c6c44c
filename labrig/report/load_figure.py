"""The motor currents of a run over the travel of its axes."""

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labrig.report.figures import SETTINGS, svg

_PANELS = (
    ("insertion_mm", "insertion_current_ma", "Insertion axis"),
    ("linear_mm", "linear_current_ma", "Linear axis"),
)
_WAYS = (("forwards", 1, "#0072b2"), ("backwards", -1, "#d55e00"))
_BIN_MM = 1.0
_MOVED_MM = 1e-6
_LEAST_TRAVEL_MM = 0.5


def draw_load_figure(states: pd.DataFrame, name: str) -> Markup | None:
    """Draw median and range of the motor current in each millimetre of travel, forwards and backwards.

    Parameters
    ----------
    states : DataFrame
        The state lines of a run.
    name : str
        Makes the identifiers of the figure unique within the page.

    Returns
    -------
    Markup or None
        None for a run without currents, or whose axes stood still.
    """
    shown = [panel for panel in _PANELS if panel[1] in states and _has_travelled(states, panel)]
    if not shown:
        return None
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(9.6, 3.2), layout="constrained")
        for axes, panel in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
            _draw_panel(axes, states, panel)
        return svg(figure, name)


def _has_travelled(states: pd.DataFrame, panel: Sequence[str]) -> bool:
    position, current, _ = panel
    return bool(states[current].notna().any()) and float(np.ptp(states[position])) > _BIN_MM


def _draw_panel(axes: Axes, states: pd.DataFrame, panel: Sequence[str]) -> None:
    position, current, title = panel
    axes.set_title(title)
    step_mm = states[position].diff().fillna(0.0)
    for label, sign, colour in _WAYS:
        moved = states[sign * step_mm > _MOVED_MM]
        if moved.empty:
            continue
        bins = np.floor(moved[position] / _BIN_MM)
        found = moved.groupby(bins)[current].agg(["median", "min", "max"])
        # An axis that comes to rest within a bin draws no current there, which is no load of its travel.
        found = found[moved[position].abs().groupby(bins).agg(np.ptp) > _LEAST_TRAVEL_MM]
        middle_mm = (found.index.to_numpy() + 0.5) * _BIN_MM
        axes.fill_between(middle_mm, found["min"], found["max"], color=colour, alpha=0.2, linewidth=0)
        axes.plot(middle_mm, found["median"], color=colour, linewidth=1.2, label=label)
    axes.set_xlabel("position (mm)")
    axes.set_ylabel("motor current (mA)")
    axes.grid(visible=True)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="best", handlelength=1.2)
