"""The figures of a page as files for a paper."""

import io
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path

import matplotlib as mpl

from labrig.durable import write_atomically
from labrig.record.reader import Run
from labrig.report.figures import NO_METADATA, SETTINGS, DrawnFigure
from labrig.report.load_figure import draw_load_figure
from labrig.report.page import Page

# Type 42 keeps text as text, which journals ask for; equal figures give equal files.
_PDF_SETTINGS = {**SETTINGS, "pdf.fonttype": 42}
_METADATA = {"svg": NO_METADATA, "pdf": {"Creator": None, "Producer": None, "CreationDate": None}}


def write_figures(folder: Path, run: Run, page: Page) -> None:
    """Write every figure of a page as NAME.svg and NAME.pdf; camera pictures are not among them. Raises `DiskError`."""
    load = draw_load_figure(run.states, "load")
    for drawn in _find_figures([page.shown, load]):
        write_figure(folder, drawn)


def write_figure(folder: Path, drawn: DrawnFigure) -> None:
    """Write a figure as NAME.svg and NAME.pdf. Raises `DiskError`."""
    for form, metadata in _METADATA.items():
        buffer = io.BytesIO()
        with mpl.rc_context(_PDF_SETTINGS):
            drawn.figure.savefig(buffer, format=form, metadata=metadata)
        write_atomically(folder / f"{drawn.name}.{form}", buffer.getvalue())


def _find_figures(value: object) -> Iterator[DrawnFigure]:
    """Yield the figures in nested values."""
    if isinstance(value, DrawnFigure):
        yield value
    elif isinstance(value, Mapping):
        for item in value.values():
            yield from _find_figures(item)
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _find_figures(item)
    elif is_dataclass(value):
        for field in fields(value):
            yield from _find_figures(getattr(value, field.name))
