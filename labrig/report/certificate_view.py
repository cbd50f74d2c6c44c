"""The certificate of a run on its page: a table of margins, and a bar for each that is known in standard deviations."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labrig.analysis.certificate import Arrivals, Certificate, Margin, describe_half, load_certificate
from labrig.record.reader import Run
from labrig.report.figures import SETTINGS, DrawnFigure, svg
from labrig.report.formatting import UNKNOWN, format_time, interval

_MOST_SDS = 10.0
"""A margin is drawn up to here; what is farther off needs no comparison."""
_BAR, _OPEN_BAR = "#0072b2", "#9ecae1"
_MINUS = "−"


@dataclass(frozen=True)
class Share:
    """How many arrived, and the interval of their share, in words."""

    count: str
    interval: str


@dataclass(frozen=True)
class MarginRow:
    """A margin in words; where `never` is true, half or more arrive wherever it was tried, up to `misses_at`."""

    name: str
    key: str
    stated: str
    sd: str
    misses_at: str
    never: bool
    half_between: str
    margin: str
    margin_sds: str
    there: Share | None
    at_sds: tuple[Share, ...]
    arrives_to: str
    end: str


@dataclass(frozen=True)
class CertificateView:
    """What a page shows of a certificate: itself, its date, its rows, and the figure, None without a margin in SDs."""

    certificate: Certificate
    created: str
    base: Share
    rows: tuple[MarginRow, ...]
    figure: DrawnFigure | None


def make_certificate_view(run: Run) -> CertificateView | None:
    """Return what the page shows of the newest certificate of a run; None without one.

    Raises
    ------
    RecordError
        When the certificate was changed or is damaged.
    """
    certificate = load_certificate(run)
    if certificate is None:
        return None
    return CertificateView(
        certificate,
        format_time(certificate.created),
        _describe_share(certificate.base),
        tuple(map(_make_row, certificate.margins, _name_margins(certificate.margins))),
        draw_margins(certificate.margins),
    )


def draw_margins(margins: Sequence[Margin]) -> DrawnFigure | None:
    """Draw the margin of each assumption in standard deviations, the smallest on top; None where none has any.

    An open bar reaches to the farthest value that was tried, where still half or more arrive.
    """
    known = [margin for margin in margins if margin.sd is not None]
    if not known:
        return None
    with mpl.rc_context(SETTINGS):
        figure = Figure(figsize=(9.6, 0.9 + 0.3 * len(known)), layout="constrained")
        axes = figure.subplots()
        for place, margin in enumerate(known):
            _draw_bar(axes, place, margin)
        for sds in (1.0, 2.0):
            axes.axvline(sds, color="#555555", linewidth=0.9, linestyle=(0, (4, 2.5)))
        axes.set_yticks(range(len(known)), _name_margins(known))
        axes.set_ylim(len(known) - 0.4, -0.6)
        axes.set_xlim(0.0, 1.12 * _MOST_SDS)
        axes.tick_params(axis="y", length=0)
        axes.set_xlabel(f"margin in standard deviations, drawn up to {_MOST_SDS:g}; dashed: 1 and 2")
        axes.grid(visible=True, axis="x")
        return svg(figure, "margins")


def _draw_bar(axes: Axes, place: int, margin: Margin) -> None:
    sds = margin.margin_sds
    reach = margin.tried_sds if sds is None else sds
    assert reach is not None
    colour = _OPEN_BAR if sds is None else _BAR
    length = min(reach, _MOST_SDS)
    axes.barh(place, length, height=0.62, color=colour)
    text = f"> {reach:.2g}" if sds is None else f"{reach:.2g}"
    axes.annotate(text, (length, place), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8.5)


def _name_margins(margins: Sequence[Margin]) -> list[str]:
    """Return what is turned in each, and to which side where there are two."""
    counts = Counter(margin.name for margin in margins)
    return [_name_margin(margin) if counts[margin.name] > 1 else margin.name for margin in margins]


def _name_margin(margin: Margin) -> str:
    sides = ("smaller", "larger") if margin.stated else (_MINUS, "+")
    return f"{margin.name}, {sides[margin.direction > 0]}"


def _make_row(margin: Margin, name: str) -> MarginRow:
    missed = margin.misses_at
    beyond = f"{'<' if margin.direction < 0 else '>'} {_shorten(margin.farthest)}"
    return MarginRow(
        name=name,
        key=margin.key,
        stated=f"{_shorten(margin.stated)} {margin.unit}".rstrip(),
        sd=_shorten(margin.sd),
        misses_at=beyond if missed is None else _shorten(missed.value),
        never=missed is None,
        half_between=describe_half(margin, _shorten),
        margin=_shorten(margin.margin),
        margin_sds=UNKNOWN if margin.margin_sds is None else f"{margin.margin_sds:.1f}",
        there=None if missed is None else _describe_share(missed.arrivals),
        at_sds=tuple(_describe_share(tried.arrivals) for tried in margin.at_sds),
        arrives_to=_shorten(margin.arrives_to),
        end=UNKNOWN if margin.main_end is None else margin.main_end.replace("_", " "),
    )


def _describe_share(arrivals: Arrivals) -> Share:
    limits = interval([100.0 * limit for limit in arrivals.share_ci95], 0)
    return Share(f"{arrivals.arrived} of {arrivals.n}", f"{limits} %")


def _shorten(value: float | None) -> str:
    return UNKNOWN if value is None else f"{value:.3g}".replace("-", _MINUS)
