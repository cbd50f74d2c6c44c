"""The page of a run: complete, self-contained, escaped, and the same each time."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

from labrig.analysis.run import analyze_run
from labrig.experiments.registry import find_run_experiment
from labrig.record.notes import annotate_run
from labrig.record.reader import open_run
from tests.analysis.synthetic import NOW, PROVENANCE, SyntheticSweep, abort_sweep, record_import, record_sweep
from tests.experiments.camera_calibration.recorded import record_calibration
from tests.pages import write_page
from tests.report.conftest import HOSTILE, WrittenPage, make_page

VOID = {"meta", "br", "wbr", "img", "link", "input", "hr"}
READING = r"for the place of a tip, also how far off its end may be read: .* over which it fades in .* 0\.0\d+ 0\.\d+"


class _Elements(HTMLParser):
    """Collects elements with their attributes, all text, and what is opened and not closed."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.text = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self.text += "" if tag == "wbr" else " "  # a line may end at a wbr; a word does not
        self.open += [tag] * (tag not in VOID)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += "" if self.open[-1:] == ["style"] else data


def _words(html: str) -> str:
    return " ".join(_Elements(html).text.split())


def test_the_page_is_well_formed_and_reached_by_the_keyboard(page: WrittenPage) -> None:
    """Elements are closed in order, names are unique, what scrolls sideways takes the focus, headers have words."""
    elements = _Elements(page.html)
    assert elements.open == []
    identifiers = [attributes["id"] for _, attributes in elements.elements if "id" in attributes]
    assert len(identifiers) == len(set(identifiers))
    classes = [(set((of.get("class") or "").split()), of.get("tabindex")) for _, of in elements.elements]
    assert {tabindex for names, tabindex in classes if "scroll" in names} == {"0"}
    assert re.search(r"<th[^>]*></th>", page.html) is None


def test_nothing_is_fetched_from_anywhere(page: WrittenPage) -> None:
    """The page has no network address and no script, and contains its pictures."""
    elements = _Elements(page.html).elements
    named = (pair for _, attributes in elements for pair in attributes.items())
    links = [value or "" for name, value in named if name in {"src", "href", "xlink:href"}]
    assert links
    assert [link for link in links if not link.startswith(("data:", "#", "analysis/"))] == []
    assert not {tag for tag, _ in elements} & {"script", "link", "iframe", "object"}
    assert re.findall(r"https?://|url\((?!#)", page.html) == []


def test_no_line_ends_before_a_unit_and_the_words_of_the_page_are_explained(page: WrittenPage) -> None:
    """A number keeps its unit, but in what is to be copied; an explained word stands elsewhere too."""
    text = re.sub(r"<code>.*?</code>|<[^>]*>", "", page.html.partition("</style>")[2], flags=re.DOTALL)
    assert re.findall(r"\d (?:mm|px|degrees|%)(?!\w)", text) == []
    assert re.search(r"27\.\d\d\u00a0mm", text)
    before, explained, after = re.split("<h2>(?:Words|Provenance)</h2>", page.html.replace("\u00a0", " "))
    words = re.findall(r"<dt>(.*?)</dt><dd>.{10,}</dd>", explained)
    assert {"SD", "sheath", "graph paper", "median"} <= set(words)
    assert "NIS" not in words
    assert [word for word in words if (before + explained + after).lower().count(word.lower()) < 2] == []


def test_what_people_wrote_is_text(tmp_path: Path) -> None:
    """HTML in title, operator, notes, specimen and annotations is shown as text; damaged annotations are named."""
    sweep = SyntheticSweep(
        radii_mm={HOSTILE: (28.0,)}, gelatin_percent=(10.0,), title=HOSTILE, operator=HOSTILE, notes=HOSTILE
    )
    run = record_sweep(tmp_path, sweep)
    annotate_run(run.path, tags=["pilot"], note=HOSTILE, verdict="doubtful", by="Chen", at=NOW)
    made = make_page(run)
    elements = _Elements(made.html)
    assert elements.open == []
    assert "script" not in {tag for tag, _ in elements.elements}
    assert elements.text.count(HOSTILE) >= 6
    assert "<script" not in made.html
    assert "Verdict doubtful Tags pilot Note 1, Chen, " in _words(made.html)
    (run.path / "notes.json").write_text("not a line\n")
    assert "notes.json" in _words(write_page(open_run(run.path), None, NOW).read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("begin", "pattern"),
    [
        ("complete", r"3 of 4 insertions measured: .* the paper found 27\.\d.mm in \w+ gels\. .* The rig is simulated"),
        ("by needle and gel", r"10 % gel A N1 2 28\.3\d 0\.4\d\d 2\d\.\d\d to 3\d\.\d\d 0 28\.34 0\.247 28\.30"),
        ("by needle and gel", r"19 % gel B N1 1 2[67]\.\d\d – – 1 27\.13 0\.473 27\.20"),
        ("by needle and gel", r"Mean of the means 27\.6\d ± 0\.\d\d 27\.7 "),
        ("Every final picture", r" z y 5 mm .*trial 1, hole 1"),
        ("Refused pictures", r"10\.0 3 Of 1\d\.\d mm of needle"),
        ("How sure", r"surface refraction at the gel's surface, and at glass before it not known not known"),
        ("How sure", f"fit scatter of the edges about the fit; {READING}"),
        ("Provenance", r"recorded with labrig .* measured with labrig .* analysis/001.* scale at the sheath's tip"),
        ("In full", r"window_start_mm 4 .* SHA-256 of what the record holds .* Devices "),
        ("In full", r"exposure_s 0\.01"),
        ("In full", r"drive\.hardware_version 0x6220 .*drive\.software_version 0x2110"),
    ],
)  # fmt: skip
def test_the_page_states_what_was_found_and_how_sure(begin: str, pattern: str, page: WrittenPage) -> None:
    """Behind the heading of each part stand its numbers: what was measured, how sure, by which code and devices."""
    assert re.search(pattern, _words(page.html).partition(begin)[2])


def test_everything_behind_the_numbers_is_named_and_shown(page: WrittenPage) -> None:
    """Each input by its hash, each refused picture, the tables by their paths; a picture a final frame with its key."""
    assert page.result is not None
    words = _words(page.html)
    named = [row["image"] for row in page.result.document["measurements"] if not row["found"]]
    assert [text for text in (*page.result.content.inputs.values(), *named) if text not in words] == []
    links = {a["href"] or "" for tag, a in _Elements(page.html).elements if tag == "a"}
    assert {Path(link).name for link in links} == {"specimens.csv", "measurements.csv", "origins.csv"}
    assert all((page.run.path / link).is_file() for link in links)
    sheet = page.html.split("Every final picture")[1]
    assert (sheet.count("<image "), sheet.count('class="window"')) == (4, 3)
    assert sheet.count('<polyline class="circle"') >= 3
    assert '<span class="swatch dashed" style="color:#ffa600"></span>fitted circle' in page.html
    assert re.search(r"\.circle {[^}]*stroke-dasharray", page.html)


def test_every_picture_enlarges(page: WrittenPage) -> None:
    """Each picture is a button that opens a popover, which draws it again without a second copy of its data."""
    elements = _Elements(page.html).elements
    buttons = {attributes.get("popovertarget") for tag, attributes in elements if tag == "button"}
    popovers = {attributes["id"] or "" for _, attributes in elements if "popover" in attributes}
    drawings = {attributes.get("id") for tag, attributes in elements if tag == "g"}
    assert len(popovers) == page.html.count("<image ") == page.html.count("data:image/jpeg")
    assert buttons == popovers
    drawn = {name.removesuffix("-large") for name in popovers}
    assert drawn <= drawings
    assert {page.html.count(f'<use href="#{name}"/>') for name in drawn} == {1}


def test_the_same_run_gives_the_same_page(page: WrittenPage) -> None:
    """Written twice from the same result, the page is the same, byte for byte."""
    assert write_page(page.run, page.result, NOW).read_text(encoding="utf-8") == page.html


STOPPED = SyntheticSweep(exit_status="aborted", without_final=frozenset({3}))


@pytest.mark.parametrize(
    ("sweep", "word", "pattern"),
    [
        (
            abort_sweep(SyntheticSweep()), "aborted",
            r"The run was aborted: the operator said no\. 3 of 4 planned insertions ended\. .* in its gel.* resume",
        ),
        (SyntheticSweep(exit_status="failed"), "failed", r"The run failed: the operator said no\."),
        (
            replace(STOPPED, exit_status=None), "incomplete",
            (r"The run was never closed: .* left in its gel, .*: the run stopped within trial 4\. "
             "At the last recorded reading the insertion axis stood .*labrig resume"),
        ),
        (
            STOPPED, "aborted",
            r"left in its gel, .*: .* insertion axis stood at 30\.00 mm and the linear axis, .*, at 15\.00 mm",
        ),
        (replace(STOPPED, without_needle=frozenset(range(4))), "aborted", "in its gel.* in 3 of them: No needle.*Next"),
        (replace(STOPPED, radii_mm={"gel A": ()}, gelatin_percent=(10.0,)), "aborted", "No radius could be stated"),
    ],
)  # fmt: skip
def test_a_run_that_did_not_end_has_a_page_that_says_so(
    tmp_path: Path, sweep: SyntheticSweep, word: str, pattern: str
) -> None:
    """Beside the title the status, then what is missing, whether a needle is left in, and how to go on."""
    made = make_page(record_sweep(tmp_path, sweep))
    head = _words(made.html.split("</header>")[0])
    assert f'<span class="pill {word}">{word}</span>' in made.html
    assert re.search(pattern, head)
    assert ("in its gel" in head) == ("in its gel" in pattern)


def test_a_picture_that_is_gone_or_was_changed_is_named(tmp_path: Path) -> None:
    """One that is gone leaves a gap with its refusal; one that was whole again since it was measured is told too."""
    run = record_sweep(tmp_path)
    file = run.path / run.frame_table.loc[run.frame_table["role"] == "final", "file"].iloc[0]
    content = file.read_bytes()
    file.write_bytes(content[:-1])
    result = analyze_run(run, find_run_experiment(run), workers=1, created=NOW, provenance=PROVENANCE)
    file.write_bytes(content)
    words = _words(write_page(open_run(run.path), result, NOW).read_text(encoding="utf-8"))
    assert "The record was damaged when this was measured." in words
    assert f"frames/{file.name}: it does not fit" in words
    file.unlink()
    words = _words(make_page(run).html)
    missing = f"frames/{file.name}: it is missing, though SHA256SUMS lists it"
    told = ("picture cannot be read", "The record is not whole", missing, "No such file")
    assert [text for text in told if text not in words] == []


def test_a_real_rig_has_no_columns_of_truth(tmp_path: Path) -> None:
    """Without a truth the page says nothing of a simulation; before any analysis, how to measure."""
    run = record_sweep(tmp_path, SyntheticSweep(truth=False))
    made = make_page(run, analysed=False)
    assert f"<code>labrig reanalyze {run.path}</code>" in made.html
    assert ("`" in _words(made.html), _Elements(made.html).open) == (False, [])
    assert "simulat" not in _words(make_page(run).html).lower()


def test_a_sweep_tells_its_gels_apart_as_a_comparison_does(tmp_path: Path) -> None:
    """Of the blocks that were measured: the difference in the opening, and its interval in the table of pairs."""
    sweep = SyntheticSweep(radii_mm={"gel A": (28.2, 28.4), "gel B": (26.0, 26.1)})
    words = _words(make_page(record_sweep(tmp_path, sweep)).html)
    opening = r"The softer the block of gel, .*: from 10 to 19 % it falls by 2\.\d\d mm \(95 %: 1\.\d\d to"
    assert re.search(opening, words)
    assert re.search(r"10 % gelatin 19 % gelatin \+2\.\d\d 1\.\d\d to [23]\.\d\d 0\.0\d\d", words)


def test_imported_pictures_have_a_page_of_their_own(tmp_path: Path) -> None:
    """Each picture has a line with found, tip and reason, under its own file name."""
    words = _words(make_page(record_import(tmp_path, (28.0, None))).html)
    stated = r"a radius can be stated in 1: 2[78]\.\d\d mm, with a standard deviation of 0\.\d\d mm "
    stated += r"by the misfit to a circle and the light alone\."
    assert re.search(f"Shaft and tip were found in 1 of 2 pictures; {stated}", words)
    assert re.search(r"photo0\.jpg yes −\d\d\.\d\d \d\d\.\d\d 0\.\d\d \d\d\.\d 2[78]\.\d\d", words)
    assert re.search(r"photo1\.jpg no – – – – – – – no No needle", words)


@pytest.mark.parametrize(
    ("views", "told"),
    [
        (0, ("no picture of the board was recorded",)),
        (
            10,
            (
                r"refractive index is 1\.35 throughout\.",
                r"intrinsics\.json, plane\.json, result\.json",
                r"fx \(px\) (1799|180[01])\.\d{3} 0\.\d{3}",
            ),
        ),
    ],
)
def test_a_calibration_has_a_page_accepted_or_not(tmp_path: Path, views: int, told: tuple[str, ...]) -> None:
    """Lens, residuals, coverage and plane are shown; a calibration without pictures says what is missing."""
    made = make_page(record_calibration(tmp_path, views, gel="{index: 1.35, depth_mm: 10}"))
    words = _words(made.html)
    assert ([text for text in told if not re.search(text, words)], _Elements(made.html).open) == ([], [])
