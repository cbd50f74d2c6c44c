"""Builds the manual as a site by Sphinx, in which every warning is an error; a link that leads nowhere is one.

make manual
"""

import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from sphinx.cmd.build import build_main

from labrig import __version__
from labrig.report.manual import INDEX, KINDS, ManualPage
from tests.manual.pages import PAGES, ROOT

_CONFIGURATION = {
    "project": "labrig",
    "release": __version__,
    "extensions": "myst_parser",
    "myst_heading_anchors": "4",
    "html_theme": "alabaster",
    "html_theme_options.page_width": "72rem",
    "html_copy_source": "0",
}


def write_sources(pages: Sequence[ManualPage], folder: Path) -> None:
    """Write every page, generated ones too, and the files of the manual; the first page leads to all others."""
    written = ROOT / "labrig" / "manual"
    shutil.copytree(written, folder, ignore=shutil.ignore_patterns("__pycache__"))
    for page in pages:
        path = folder / f"{page.place}.md"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(page.read() + "\n", encoding="utf-8")
    with (folder / f"{INDEX}.md").open("a", encoding="utf-8") as first:
        for kind, name in KINDS.items():
            listed = "\n".join(page.place for page in pages if page.kind == kind)
            first.write(f"\n```{{toctree}}\n:hidden:\n:caption: {name}\n\n{listed}\n```\n")


def main(folder: Path) -> int:
    """Build the site in `folder/html`, and return Sphinx' exit code."""
    shutil.rmtree(folder, ignore_errors=True)
    write_sources(list(PAGES.values()), folder / "source")
    settings = [word for key, value in _CONFIGURATION.items() for word in ("-D", f"{key}={value}")]
    places = [str(folder / "source"), str(folder / "html")]
    return build_main(["-q", "-W", "--keep-going", "-C", "-b", "html", *settings, *places])


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
