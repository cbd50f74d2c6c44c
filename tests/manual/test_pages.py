"""The pages of the manual: their links lead somewhere, and what they name is there."""

import json
import shlex
from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path

import pytest
import typer
from typer.core import TyperCommand, TyperGroup

from labrig.cli.command_reference import read_tree
from labrig.cli.main import app
from labrig.cli.options import complete_live
from labrig.devices.rig_file import load_rig
from labrig.experiments.declared import list_usable_models
from labrig.protocol.formatting import Plain
from labrig.protocol.load import load_protocol
from labrig.protocol.yaml_tree import load_yaml_values
from labrig.report.manual import ManualPage, find_manual, find_target, is_elsewhere
from labrig.report.markdown import Fence, find_headings, find_links, parse
from tests.manual.lab import make_lab_folder
from tests.manual.pages import KINDS, PAGES, README, ROOT, list_blocks, list_lines

BLOCKS = {
    f"{page.place}:{block.line}": block for page in (README, *PAGES.values()) for block in list_blocks(page)
}
SHELL = {place: block for place, block in BLOCKS.items() if block.info.startswith("sh")}
YAML = {place: block for place, block in BLOCKS.items() if block.info.startswith("yaml")}
ANCHORS = {
    place: {heading.anchor for heading in find_headings(parse(page.read()))} for place, page in PAGES.items()
}


@pytest.fixture(scope="module")
def tree() -> TyperGroup:
    """Return the tree of commands."""
    return read_tree(app)


@pytest.fixture(scope="module")
def lab_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a lab folder that no test changes but for files of its own."""
    return make_lab_folder(tmp_path_factory.mktemp("lab"))


@pytest.mark.parametrize("page", PAGES.values(), ids=PAGES)
def test_links_lead_somewhere(page: ManualPage) -> None:
    """To a page and its heading, or to a file of the manual."""
    assert [link for link in find_links(parse(page.read())) if not _leads_somewhere(page, link)] == []


def _leads_somewhere(page: ManualPage, link: str) -> bool:
    if is_elsewhere(link):
        return link.startswith("https://")
    target = find_target(page.place, link)
    anchor = link.partition("#")[2]
    if target.removesuffix(".md") in PAGES:
        return not anchor or anchor in ANCHORS[target.removesuffix(".md")]
    return not target.startswith("..") and (find_manual() / target).is_file()


def test_the_readme_is_short_and_its_links_lead_somewhere() -> None:
    """At most 120 lines; links lead to files of the checkout, and to headings of the manual's pages."""
    assert len(README.read().splitlines()) <= 120
    own = {heading.anchor for heading in find_headings(parse(README.read()))}
    for link in find_links(parse(README.read())):
        path, _, anchor = link.partition("#")
        place = path.removeprefix("labrig/manual/").removesuffix(".md")
        assert is_elsewhere(link) or not path or (ROOT / path).exists(), link
        assert not anchor or anchor in (ANCHORS[place] if path else own), link


def test_every_page_begins_with_its_title() -> None:
    """Which is its only heading of the first level."""
    for page in PAGES.values():
        headings = find_headings(parse(page.read()))
        assert [heading.text for heading in headings if heading.level == 1] == [page.title], page.place
        assert headings[0].level == 1, page.place


@pytest.mark.parametrize("page", PAGES.values(), ids=PAGES)
def test_no_code_is_indented_instead_of_fenced(page: ManualPage) -> None:
    """A block without a kind would be checked by nothing."""
    assert [token.map for token in parse(page.read()) if token.type == "code_block"] == []


@pytest.mark.parametrize("block", BLOCKS.values(), ids=BLOCKS)
def test_every_block_is_of_a_kind(block: Fence) -> None:
    """So that each is checked."""
    assert KINDS.fullmatch(block.info), block.info


@pytest.mark.parametrize("block", SHELL.values(), ids=SHELL)
def test_every_command_and_option_exists(block: Fence, tree: TyperGroup) -> None:
    """Also those that no test runs; a wrong name, and an option without its value, are refused by the parser."""
    for line in list_lines(block):
        words = shlex.split(line.command, comments=True)
        words = list(takewhile(lambda word: word not in {">", "|", "&&"}, words))
        if words and words[0] == "labrig":
            _parse(tree, complete_live(words[1:]))


def _parse(tree: TyperGroup, words: list[str]) -> None:
    """Parse a command line with the parser of its command; nothing of it is carried out."""
    command: TyperCommand | TyperGroup = tree
    while isinstance(command, TyperGroup) and words and not words[0].startswith("-"):
        found = command.commands.get(words[0])
        assert isinstance(found, TyperCommand | TyperGroup), f"no command {words[0]}"
        command, words = found, words[1:]
    context = typer.Context(command, info_name="labrig")
    _, left, _ = command.make_parser(context).parse_args(words)
    assert left == [], f"nothing takes {left}"


@pytest.mark.parametrize(
    "line", ["labrig cheque x", "labrig check x --rigg y", "labrig check x --rig", "labrig runs tags last"]
)
def test_a_wrong_command_would_be_found(line: str, tree: TyperGroup) -> None:
    """A misspelt command or option, and one without its value."""
    with pytest.raises((AssertionError, typer.TyperException)):
        _parse(tree, line.split()[1:])


@pytest.mark.parametrize("block", YAML.values(), ids=YAML)
def test_every_yaml_is_valid(block: Fence, lab_folder: Path, tmp_path: Path) -> None:
    """Put into the example file that it names, it is a protocol or a rig file."""
    (tmp_path / "block.yaml").write_text(block.text, encoding="utf-8")
    values = load_yaml_values(tmp_path / "block.yaml")
    kind, _, name = block.info.removeprefix("yaml").strip().partition("=")
    if not kind:
        return
    folder, stem = ("protocols", name) if kind == "protocol" else ("calibration", f"rig-{name}")
    merged = _merge(load_yaml_values(lab_folder / folder / f"{stem}.yaml"), values)
    file = lab_folder / folder / f"{tmp_path.name}.yaml"
    file.write_text(json.dumps(merged), encoding="utf-8")
    if kind == "protocol":
        load_protocol(file, list_usable_models())
    else:
        load_rig(file)


def _merge(below: Plain, above: Plain) -> Plain:
    """Return a file with other values for some of its keys."""
    if not isinstance(below, dict) or not isinstance(above, dict):
        return above
    return {**below, **{key: _merge(below.get(key), value) for key, value in above.items()}}


def test_the_references_have_the_keys_of_the_examples() -> None:
    """Each key of each example protocol, campaign and rig file has a row."""
    campaigns = set(ROOT.glob("protocols/campaign-*.yaml"))
    for place, files, below in (
        ("reference/protocol", set(ROOT.glob("protocols/*.yaml")) - campaigns, 1),
        ("reference/campaign", campaigns, 0),
        ("reference/rig", set(ROOT.glob("calibration/*.yaml")), 1),
    ):
        text = PAGES[place].read()
        for file in files:
            missing = [key for key in _list_keys(load_yaml_values(file), below) if f"| `{key}` |" not in text]
            assert missing == [], file


def _list_keys(value: Plain, below: int = 1) -> Iterator[str]:
    """Yield the keys of a file, down to its sections; below them names are those of gels and inputs too."""
    for key, inner in value.items() if isinstance(value, dict) else ():
        yield key
        if below:
            yield from _list_keys(inner, below - 1)
