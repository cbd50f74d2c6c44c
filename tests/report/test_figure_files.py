"""The figures of a page as files for a paper."""

from pathlib import Path

from labrig.experiments.registry import find_run_experiment, load_run_protocol
from labrig.report.figure_files import write_figures
from tests.report.conftest import WrittenPage


def test_the_figures_of_a_page_become_files(page: WrittenPage, tmp_path: Path) -> None:
    """SVG and PDF, the same bytes each time."""
    for folder in (tmp_path / "a", tmp_path / "b"):
        folder.mkdir()
        shown = find_run_experiment(page.run).page(page.run, load_run_protocol(page.run), page.result)
        write_figures(folder, page.run, shown)
    written = {path.name: path.read_bytes() for path in (tmp_path / "a").iterdir()}
    assert written.keys() >= {"paths.svg", "paths.pdf"}
    assert written["paths.pdf"].startswith(b"%PDF")
    assert written == {path.name: path.read_bytes() for path in (tmp_path / "b").iterdir()}
