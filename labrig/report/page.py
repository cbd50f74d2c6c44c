"""What a page shows, as its experiment gives it; loads nothing that draws."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from labrig.report.film_pictures import Film
from labrig.report.formatting import Rows


@dataclass(frozen=True)
class Page:
    """The content of a page, from an experiment.

    Attributes
    ----------
    facts : tuple
        Terms and values of the protocol; shown without a result too.
    template : Path or None
        The experiment's template, which extends `base.html.jinja`; None shows only the head.
    verdict : sequence of str
        The result in a sentence or two.
    calibration : tuple
        Accuracy of lens and plane.
    shown : Mapping
        Variables of the template, with all drawings.
    make_films : callable
        Returns films of the recorded pictures.
    """

    facts: Rows = ()
    template: Path | None = None
    verdict: Sequence[str] = ()
    calibration: Rows = ()
    shown: Mapping[str, Any] = field(default_factory=dict)
    make_films: Callable[[], Sequence[Film]] = tuple
