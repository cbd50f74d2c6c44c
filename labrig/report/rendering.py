"""Pages from templates, whatever they show."""

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from labrig.report.formatting import interval, mark_breaks, number, signed
from labrig.text import format_count

TEMPLATES = Path(__file__).parent / "templates"
_FILTERS = {
    "number": number,
    "signed": signed,
    "interval": interval,
    "count_of": format_count,
    "breakable": mark_breaks,
}
_NONE: Mapping[str, Any] = MappingProxyType({})


def render(template: Path, context: Mapping[str, Any], filters: Mapping[str, Any] = _NONE) -> str:
    """Return a page; text in it is escaped, and a variable that is missing is refused. `filters` are added to ours."""
    environment = _open_environment(template.parent, tuple(filters.items()))
    return environment.get_template(template.name).render(context)


@lru_cache(maxsize=8)
def _open_environment(folder: Path, filters: tuple[tuple[str, Any], ...]) -> Environment:
    """Return what reads templates of a folder and ours; it is kept, since each template is compiled once in it."""
    environment = Environment(
        loader=FileSystemLoader([folder, TEMPLATES]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update({**_FILTERS, **dict(filters)})
    return environment
