"""Whether what was computed again agrees with what is recorded: identical, equivalent or different.

Two processors round differently. What labrig decided must be the same on both, and each number within the tolerance of
its quantity: a tenth of the standard deviation that stands beside it, or, where none does, what its unit allows
(`TOLERANCES`). A replay and a reanalysis are judged by this one table, and so are the kept records of the tests.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

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

_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")

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
    quantity : str
        Its name: dotted path, `*` in place of the numbers of items.
    recorded, now : object
        Both values.
    size, tolerance : float or None
        The difference of two numbers, and what is allowed; None of anything else, which is a decision.
    """

    quantity: str
    recorded: object
    now: object
    size: float | None = None
    tolerance: float | None = None

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
    first : Deviation or None
        The first decision, or number beyond its tolerance.
    beyond : int
        How many there are.
    """

    largest: dict[str, float] = field(default_factory=dict)
    first: Deviation | None = None
    beyond: int = 0
    _rounded: bool = False

    @property
    def verdict(self) -> Verdict:
        """The verdict so far."""
        if self.beyond:
            return Verdict.DIFFERENT
        return Verdict.EQUIVALENT if self._rounded else Verdict.IDENTICAL

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
        self._rounded = True
        if deviation.size is not None:
            known = self.largest.get(deviation.quantity, 0.0)
            self.largest[deviation.quantity] = max(known, deviation.size)
        if not deviation.is_within:
            self.first = self.first or deviation
            self.beyond += 1


def find_deviations(name: str, recorded: object, now: object) -> Iterator[Deviation]:
    """Yield each value of a document that is not the recorded one, in the order of the record."""
    yield from _walk(name, recorded, now, _NO_OWNER, 0.0)


def _walk(
    name: str, recorded: object, now: object, owner: Mapping[str, object], scale: float
) -> Iterator[Deviation]:
    """Compare a value that stands in the mapping `owner`, in a list whose largest number is `scale`."""
    if recorded == now:
        return
    if isinstance(recorded, Mapping) and isinstance(now, Mapping):
        for key in dict.fromkeys((*recorded, *now)):
            yield from _walk(f"{name}.{key}", recorded.get(key), now.get(key), recorded, 0.0)
    elif _are_lists(recorded, now):
        assert isinstance(recorded, Sequence)
        assert isinstance(now, Sequence)
        largest = max((abs(number) for number in recorded if isinstance(number, float)), default=0.0)
        for before, after in zip(recorded, now, strict=True):
            yield from _walk(f"{name}.*", before, after, owner, max(scale, largest))
    elif isinstance(recorded, float) and isinstance(now, float):
        size = abs(now - recorded)
        yield Deviation(name, recorded, now, size, _find_tolerance(name, recorded, owner, scale))
    elif isinstance(recorded, str) and isinstance(now, str):
        yield from _compare_texts(name, recorded, now)
    else:
        yield Deviation(name, recorded, now)


def _are_lists(recorded: object, now: object) -> bool:
    return isinstance(recorded, list | tuple) and isinstance(now, list | tuple) and len(recorded) == len(now)


def _compare_texts(name: str, recorded: str, now: str) -> Iterator[Deviation]:
    """Compare two sentences: the same words, and numbers that differ by one in their last digit at most."""
    if _NUMBER.sub("#", recorded) != _NUMBER.sub("#", now):
        yield Deviation(name, recorded, now)
        return
    for before, after in zip(_NUMBER.findall(recorded), _NUMBER.findall(now), strict=True):
        if before != after:
            digit = _last_digit(before)
            if digit >= 1:  # whole numbers count something: holes, pictures, arcs
                yield Deviation(name, recorded, now)
            else:
                yield Deviation(name, recorded, now, abs(float(after) - float(before)), 1.001 * digit)


def _last_digit(number: str) -> float:
    """Return the value of one in the last digit of a number as it is written."""
    mantissa, _, exponent = number.partition("e")
    decimals = len(mantissa.partition(".")[2])
    return float(10.0 ** (int(exponent or 0) - decimals))


def _find_tolerance(name: str, value: float, owner: Mapping[str, object], scale: float) -> float:
    sd = _find_sd(name, owner)
    if sd is not None:
        return SHARE_OF_SD * sd
    word = _last_key(name).rpartition("_")[2]
    return TOLERANCES.get(word, _RELATIVE * max(abs(value), scale))


def _last_key(name: str) -> str:
    """Return the last key of a dotted path that is no number of an item."""
    return next(key for key in reversed(name.split(".")) if key != "*")


def _find_sd(name: str, owner: Mapping[str, object]) -> float | None:
    """Return the standard deviation that stands beside a quantity, by the names that records use; None without one."""
    key = _last_key(name)
    stem, _, unit = key.rpartition("_")
    sigma = owner.get("sigma")
    beside = (
        owner.get(f"sigma_{key}"),
        owner.get(f"{stem}_sd_{unit}"),
        sigma.get(key) if isinstance(sigma, Mapping) else None,
    )
    return next((sd for sd in beside if isinstance(sd, float) and math.isfinite(sd) and sd > 0), None)
