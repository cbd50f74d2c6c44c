"""The certificate of a run: what would have to be wrong for it to miss. Its document, in `RUN/certificate/NNN/`.

`labrig campaign --certify` computes it. It is no result of the record: nothing of it was measured.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from pydantic import ValidationError

from labrig.analysis.result import describe_error
from labrig.durable import write_atomically
from labrig.errors import RecordError
from labrig.input_file import MAX_RESULT_BYTES, read_file
from labrig.protocol.model import Model
from labrig.record.json_lines import encode_document
from labrig.record.reader import Run

CERTIFICATE_FILE = "certificate.json"
_AGAIN = "make a new one: labrig campaign --certify RUN"

Interval = tuple[float, float]


class Arrivals(Model):
    """How many of `n` virtual repetitions arrived, with Wilson's 95 % interval of the share."""

    n: int
    arrived: int
    share_ci95: Interval

    @property
    def share(self) -> float:
        """The share that arrived."""
        return self.arrived / self.n


class TriedValue(Model):
    """The repetitions at one value of an assumption; `ends` counts how those ended that did not arrive."""

    value: float
    arrivals: Arrivals
    ends: dict[str, int]


class Margin(Model):
    """How far one assumption may be wrong in one direction.

    Attributes
    ----------
    name, unit, key : str
        The assumption, and the key of the simulated world that was turned.
    direction : int
        -1: below the stated value, 1: above it.
    stated : float
        The value by which the run planned, in the unit.
    sd : float or None
        Its standard deviation as the protocol or the record states it.
    misses_at : Trial or None
        The smallest step away at which fewer than half arrive; None if at least half arrive wherever it was tried.
    half_between : (float or None, float or None)
        The farthest value at which more than half arrive for sure, by the interval of the share, and the nearest at
        which fewer do; None where no tried value is sure.
    arrives_to : float or None
        The farthest value up to which at least 95 % arrived wherever it was tried; None if not even the first did.
    farthest : float
        The farthest value that was tried.
    at_sds : tuple of TriedValue
        At one and at two standard deviations, as far as they are within the limits.
    tried : tuple of TriedValue
        All, the stated value's side first.
    """

    name: str
    unit: str
    key: str
    direction: Literal[-1, 1]
    stated: float
    sd: float | None
    misses_at: TriedValue | None
    half_between: tuple[float | None, float | None]
    arrives_to: float | None
    farthest: float
    at_sds: tuple[TriedValue, ...]
    tried: tuple[TriedValue, ...]

    @property
    def margin(self) -> float | None:
        """From the stated value to where fewer than half arrive, in the unit; None if that is nowhere."""
        return None if self.misses_at is None else abs(self.misses_at.value - self.stated)

    @property
    def margin_sds(self) -> float | None:
        """The margin in standard deviations; None without one."""
        return None if self.margin is None or self.sd is None else self.margin / self.sd

    @property
    def tried_sds(self) -> float | None:
        """The farthest that was tried in standard deviations; None without one."""
        return None if self.sd is None else abs(self.farthest - self.stated) / self.sd

    @property
    def main_end(self) -> str | None:
        """How most of those ended that did not arrive, where fewer than half do."""
        return None if self.misses_at is None else next(iter(self.misses_at.ends), None)


def describe_half(margin: Margin, shorten: Callable[[float | None], str]) -> str:
    """Return in words between which values half of the repetitions arrive for sure; `shorten` writes a value."""
    more, fewer = margin.half_between
    if more is None and fewer is None:
        return shorten(None)
    if fewer is None:
        return f"beyond {shorten(more)}"
    return f"before {shorten(fewer)}" if more is None else f"{shorten(more)} to {shorten(fewer)}"


class NotTriedPart(Model):
    """What the run took for granted, and the simulated world cannot turn."""

    name: str
    why: str


class Certificate(Model):
    """What would have to be wrong for a run to miss: one assumption turned at a time, by virtual repetitions.

    Attributes
    ----------
    run : str
        The name of the run.
    created : str
        ISO 8601, UTC.
    provenance : dict
        Of the labrig that computed it.
    arrival : str
        What counts as an arrival, in words.
    notes : tuple of str
        What is to be known of the world, as sentences.
    seed, repetitions : int
        All values are tried with the same seeds, which follow from this one; at most so many at each.
    insertions : int
        Virtual repetitions in all.
    base : Arrivals
        Nothing turned.
    margins : tuple of Margin
        The smallest in standard deviations first; those without a standard deviation last. Empty if fewer than half
        arrive although nothing is turned.
    not_tried : tuple of NotTriedPart
    """

    schema_version: Literal[1] = 1
    run: str
    experiment: str
    created: str
    provenance: dict[str, Any]
    arrival: str
    notes: tuple[str, ...]
    seed: int
    repetitions: int
    insertions: int
    base: Arrivals
    margins: tuple[Margin, ...]
    not_tried: tuple[NotTriedPart, ...]


def write_certificate(run: Run, certificate: Certificate) -> Path:
    """Write a certificate into its run, and seal it; older ones stay. Return the file.

    Raises
    ------
    DiskError
        When it cannot be written; a file without its link is not used.
    """
    path = run.new_certificate_dir() / CERTIFICATE_FILE
    write_atomically(path, encode_document(certificate.model_dump(mode="json")))
    run.seal_certificate(path, certificate.created)
    return path


def load_certificate(run: Run) -> Certificate | None:
    """Return the newest certificate of a run; None without one.

    Raises
    ------
    RecordError
        When it was changed, is damaged, or has a newer schema.
    """
    path = run.find_certificate(CERTIFICATE_FILE)
    if path is None:
        return None
    try:
        return Certificate.model_validate_json(read_file(path, MAX_RESULT_BYTES))
    except (OSError, ValidationError) as error:
        raise RecordError(f"{path} cannot be read: {describe_error(error)}", _AGAIN) from error
