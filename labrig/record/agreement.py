"""Whether what was computed again agrees with what is recorded: identical, equivalent or different.

Two processors round differently. What labrig decided must be the same on both, and each number within the tolerance of
its quantity: a tenth of the standard deviation that stands beside it, or, where none does, what its unit allows
(`TOLERANCES`). A replay and a reanalysis are judged by this one table, and so are the kept records of the tests.
"""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import zip_longest

SHARE_OF_SD = 0.1
"""A number may differ by this share of the standard deviation that is stated beside it."""

TOLERANCES: Mapping[str, float] = {
    # A tenth of the error of a good sighting, 0.1 mm, and what that is in a picture at some 5 px/mm.
    "mm": 0.01,
    "px": 0.05,
    # A tenth of the error of a heading over the last 5 mm of the needle.
    "rad": 0.002,
    "deg": 0.1,
    # Normalised squares and correlations steer nothing by themselves; what they decide is compared too.
    "nis": 0.1,
    "score": 0.01,
    "distinctness": 0.01,
}
"""The last word of a quantity's name -> its tolerance, without a standard deviation beside it."""

_RELATIVE = 1e-3
"""Tolerance of other numbers, as a share of the largest of their list: coefficients, covariances, homographies."""

_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")

_NO_OWNER: Mapping[str, object] = {}


class Verdict(StrEnum):
    """How what was computed again agrees with the record."""

    IDENTICAL = "identical"
    EQUIVALENT = "equivalent"
    DIFFERENT = "different"


@dataclass(frozen=True)
class Deviation:
    """A value that is not the recorded one.

    Attributes
    ----------
    path : str
        Its dotted path; items of a list by their number.
    recorded, now : object
        Both values.
    size, tolerance : float or None
        The difference of two numbers, and what is allowed; None of anything else, which is a decision.
    sd : float or None
        The standard deviation that is stated beside the number.
    """

    path: str
    recorded: object
    now: object
    size: float | None = None
    tolerance: float | None = None
    sd: float | None = None

    @property
    def quantity(self) -> str:
        """Its name: the path with `*` in place of the numbers of items."""
        return ".".join("*" if key.isdigit() else key for key in self.path.split("."))

    @property
    def is_within(self) -> bool:
        """Whether the difference is within its tolerance; a decision never is."""
        return self.size is not None and self.tolerance is not None and self.size <= self.tolerance


@dataclass
class Agreement:
    """What has been compared so far.

    Attributes
    ----------
    largest : dict of str to float
        The largest difference of each quantity that differs at all.
    shares : dict of str to float
        The same as a share of its tolerance.
    in_sd : dict of str to float
        The same in standard deviations, where one is stated beside it.
    first : Deviation or None
        The first decision, or number beyond its tolerance.
    beyond : int
        How many there are.
    """

    largest: dict[str, float] = field(default_factory=dict)
    shares: dict[str, float] = field(default_factory=dict)
    in_sd: dict[str, float] = field(default_factory=dict)
    first: Deviation | None = None
    beyond: int = 0

    @property
    def verdict(self) -> Verdict:
        """The verdict so far."""
        if self.beyond:
            return Verdict.DIFFERENT
        return Verdict.EQUIVALENT if self.largest else Verdict.IDENTICAL

    def compare(self, name: str, recorded: object, now: object) -> bool:
        """Compare two documents of JSON; return whether every value is within its tolerance."""
        if recorded == now:
            return True
        before = self.beyond
        for deviation in find_deviations(name, recorded, now):
            self.add(deviation)
        return self.beyond == before

    def add(self, deviation: Deviation) -> None:
        """Take note of a value that is not the recorded one."""
        name, size = deviation.quantity, deviation.size
        if size is not None:
            self.largest[name] = max(self.largest.get(name, 0.0), size)
            share = size / deviation.tolerance if deviation.tolerance else math.inf
            self.shares[name] = max(self.shares.get(name, 0.0), share)
            if deviation.sd is not None:
                self.in_sd[name] = max(self.in_sd.get(name, 0.0), size / deviation.sd)
        if not deviation.is_within:
            self.first = self.first or deviation
            self.beyond += 1


def find_deviations(
    name: str, recorded: object, now: object, owner: Mapping[str, object] = _NO_OWNER, scale: float = 0.0
) -> Iterator[Deviation]:
    """Yield each value of a document that is not the recorded one, in the order of the record.

    Parameters
    ----------
    name : str
        The path of the document.
    recorded, now : object
        Both documents.
    owner : Mapping
        The mapping that the value stands in.
    scale : float
        The largest number of the list that it stands in.
    """
    if recorded == now:
        return
    if isinstance(recorded, Mapping) and isinstance(now, Mapping):
        for key in dict.fromkeys((*recorded, *now)):
            yield from find_deviations(f"{name}.{key}", recorded.get(key), now.get(key), recorded)
    elif isinstance(recorded, list | tuple) and isinstance(now, list | tuple):
        largest = max((abs(number) for number in recorded if isinstance(number, float)), default=0.0)
        for number, (before, after) in enumerate(zip_longest(recorded, now)):
            yield from find_deviations(f"{name}.{number}", before, after, owner, max(scale, largest))
    elif isinstance(recorded, float) and isinstance(now, float):
        key = next((key for key in reversed(name.split(".")) if not key.isdigit()), "")
        sd = _find_sd(key, owner)
        allowed = TOLERANCES.get(key.rpartition("_")[2], _RELATIVE * max(abs(recorded), scale))
        tolerance = allowed if sd is None else SHARE_OF_SD * sd
        yield Deviation(name, recorded, now, abs(now - recorded), tolerance, sd)
    elif isinstance(recorded, str) and isinstance(now, str):
        yield from _compare_texts(name, recorded, now)
    else:
        yield Deviation(name, recorded, now)


def _compare_texts(name: str, recorded: str, now: str) -> Iterator[Deviation]:
    """Compare two sentences: the same words, and numbers that differ by one in their last digit at most."""
    if _NUMBER.split(recorded) != _NUMBER.split(now):
        yield Deviation(name, recorded, now)
        return
    for before, after in zip(_NUMBER.findall(recorded), _NUMBER.findall(now), strict=True):
        decimals = len(before.partition(".")[2])
        if before != after and decimals:
            yield Deviation(name, recorded, now, abs(float(after) - float(before)), 1.001 * 10.0**-decimals)
        elif before != after:  # whole numbers count something: holes, pictures, arcs
            yield Deviation(name, recorded, now)


def _find_sd(key: str, owner: Mapping[str, object]) -> float | None:
    """Return the standard deviation that stands beside a quantity; None if none does."""
    stem, _, unit = key.rpartition("_")
    sigma = owner.get("sigma")
    within = sigma.get(key) if isinstance(sigma, Mapping) else None
    for sd in (owner.get(f"sigma_{key}"), owner.get(f"{stem}_sd_{unit}"), within):
        if isinstance(sd, float) and 0 < sd < math.inf:
            return sd
    return None
