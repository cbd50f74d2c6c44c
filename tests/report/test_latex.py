"""Tables and methods for a paper."""

from pathlib import Path

from labrig.analysis.summary import Summary, TextTable
from labrig.experiments.registry import find_run_experiment, load_run_protocol
from labrig.report.figure_files import write_figures
from labrig.report.latex import escape_latex, make_latex_table, write_latex
from tests.report.conftest import WrittenPage


def test_a_table_aligns_numbers_and_escapes_what_people_wrote() -> None:
    """A name that is LaTeX is printed as it was typed, and an unknown value is an empty cell."""
    table = TextTable(
        ("name", "radius mm"), ((r"\input{x} 10 % & #1", 28.3171), ("b", None), ("c", "−1.5 to 2.0"))
    )
    lines = make_latex_table(table).splitlines()
    assert r"\textbackslash{}input\{x\} 10 \% \& \#1 & 28.317 \\" in lines
    assert r"c & $-$1.5 to 2.0 \\" in lines
    assert r"\begin{tabular}{ll}" in lines
    assert r"\begin{tabular}{lr}" in make_latex_table(TextTable(("a", "b"), (("x", "1.5"), ("y", "-"))))
    assert escape_latex("a_b\nc") == r"a\_b c"


def test_the_tables_of_a_summary_become_files(tmp_path: Path) -> None:
    """One for each table; lines of text are left out."""
    table = TextTable(("gel", "n"), (("A", 2),))
    write_latex(tmp_path, Summary((table, "a line", table), {}))
    assert {path.name for path in tmp_path.iterdir()} == {"table-1.tex", "table-2.tex"}


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
