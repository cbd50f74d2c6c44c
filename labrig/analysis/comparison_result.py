"""What a comparison of runs says, as `labrig compare --json` prints it."""

from typing import Literal

from labrig.analysis.shared_errors import Interval, SharedErrors
from labrig.protocol.model import Model

Unit = Literal["specimen", "insertion"]


class Group(Model):
    """The measurements of a group: `n` of the unit of analysis, `insertions` and `specimens` told apart.

    `mean`, `sd` and Student's `ci95` are over the n; `ci95_with_shared` adds the errors that its measurements share.
    `specimens` is None for pictures that name none, `refused` counts measurements without an accepted value.
    """

    name: str
    fields: dict[str, str]
    n: int
    insertions: int
    specimens: int | None
    refused: int
    runs: tuple[str, ...]
    mean: float | None
    sd: float | None
    ci95: Interval | None
    shared_sigma: SharedErrors | None
    ci95_with_shared: Interval | None


class WelchAnova(Model):
    """Welch's analysis of variance."""

    f: float
    df_between: float
    df_within: float
    p: float


class Pair(Model):
    """Two groups: `difference` is the mean of a less that of b, with interval and p by Games and Howell.

    Both are None where neither group has a spread.
    `shared_sigma` is what is left in the difference of the errors that measurements share.
    """

    a: str
    b: str
    difference: float
    ci95: Interval | None
    p: float | None
    shared_sigma: SharedErrors | None
    ci95_with_shared: Interval | None


class UsedRun(Model):
    """A run of the comparison: which of its results, and what is to be known of it."""

    run: str
    experiment: str
    result: int
    overrides: tuple[str, ...]
    exit_status: str
    verdict: str | None
    simulated: bool


class LeftOutRun(Model):
    """A run that is not compared, and why."""

    run: str
    reason: str


class Comparison(Model):
    """The comparison as `labrig compare --json` prints it.

    `unit` is that of the quantity; None without one. `unit_of_analysis` is what `n` counts. `settings_differ` lists the
    settings of measurement that are not the same in all results: for each value, the runs. `warnings` are sentences
    that have to be read with the numbers.
    """

    quantity: str
    unit: str | None
    by: tuple[str, ...]
    unit_of_analysis: Unit
    groups: tuple[Group, ...]
    welch_anova: WelchAnova | None
    pairs: tuple[Pair, ...]
    not_in_interval: tuple[str, ...]
    settings_differ: dict[str, dict[str, tuple[str, ...]]]
    warnings: tuple[str, ...]
    used: tuple[UsedRun, ...]
    left_out: tuple[LeftOutRun, ...]
