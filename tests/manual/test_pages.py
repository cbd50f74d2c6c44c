"""The pages of the manual: few and short, their links lead somewhere, and what they name is there."""

import json
import re
import shlex
import subprocess
import sys
from itertools import takewhile
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.main import get_command

from labrig.cli.main import app
from labrig.cli.manual import SOURCE
from labrig.cli.options import complete_live
from labrig.cli.output import PAGES as PAGES_OF_ERRORS
from labrig.cli.output import PAGES_OF_FILES
from labrig.devices.rig_file import load_rig
from labrig.experiments.declared import list_usable_models
from labrig.protocol.load import load_protocol
from labrig.protocol.tree import Plain
from labrig.protocol.yaml_text import load_yaml_values
from tests.manual.pages import KINDS, PAGES, README, ROOT, Fence, list_blocks, list_lines, parse
from tests.manual.test_blocks import make_lab_folder

MOST_PAGES, MOST_WORDS, MOST_README_LINES = 20, 9000, 112
WRITTEN = {**PAGES, "README": README}
BLOCKS = {f"{place}:{block.line}": block for place, page in WRITTEN.items() for block in list_blocks(page)}
SHELL = {place: block for place, block in BLOCKS.items() if block.info.startswith("sh")}
YAML = {place: block for place, block in BLOCKS.items() if block.info.startswith("yaml")}


@pytest.fixture(scope="module")
def lab_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a lab folder that no test changes but for files of its own."""
    return make_lab_folder(tmp_path_factory.mktemp("lab"))


def test_the_manual_is_short() -> None:
    """What nobody reads is not there: few pages, few words, and a README that fits two screens."""
    texts = [word for page in PAGES.values() for word in page.read_text(encoding="utf-8").split()]
    words = sum(re.search(r"\w", word) is not None for word in texts)
    assert (len(PAGES) <= MOST_PAGES, words <= MOST_WORDS) == (True, True), (len(PAGES), words)
    readme = README.read_text(encoding="utf-8")
    assert len(readme.splitlines()) <= MOST_README_LINES
    links = (link for link in re.findall(r"\]\(([^)#]+)", readme) if not link.startswith("https://"))
    assert [link for link in links if not (ROOT / link).exists()] == []


def test_the_site_is_built_and_each_link_leads_somewhere(tmp_path: Path) -> None:
    """Every warning of Sphinx is an error; the reference of commands and keys is generated."""
    options = ("-q", "-W", "-b", "html", "-d", tmp_path / "read")
    subprocess.run((sys.executable, "-m", "sphinx", *options, SOURCE, tmp_path), check=True, timeout=300)
    commands = re.sub(r"<[^>]+>", "", (tmp_path / "reference" / "commands.html").read_text(encoding="utf-8"))
    assert ("labrig devices withdraw" in commands, "--square-mm" in commands) == (True, True)
    keys = (tmp_path / "reference" / "keys.html").read_text(encoding="utf-8")
    for file in (*ROOT.glob("protocols/[!c]*.yaml"), *ROOT.glob("calibration/rig-*.yaml")):
        assert [key for key in load_yaml_values(file) if f">{key}<" not in keys] == [], file


@pytest.mark.parametrize("page", WRITTEN.values(), ids=WRITTEN)
def test_every_block_is_of_a_kind(page: Path) -> None:
    """So that each is checked; a page begins with its title, and no code is indented instead of fenced."""
    text = page.read_text(encoding="utf-8")
    assert text.startswith("# ")
    assert [token.map for token in parse(text) if token.type == "code_block"] == []
    assert [block.info for block in list_blocks(page) if not KINDS.fullmatch(block.info)] == []


@pytest.mark.parametrize("block", SHELL.values(), ids=SHELL)
def test_every_command_and_option_exists(block: Fence) -> None:
    """Also those that no test runs; a wrong name, and an option without its value, are refused by the parser."""
    for line in list_lines(block):
        words = shlex.split(line.command, comments=True)
        words = list(takewhile(lambda word: word not in {">", "|", "&&"}, words))
        if words and words[0] == "labrig":
            _parse(complete_live(words[1:]))


def _parse(words: list[str]) -> None:
    """Parse a command line with the parser of its command; nothing of it is carried out."""
    command: Any = get_command(app)
    while hasattr(command, "commands") and words and not words[0].startswith("-"):
        assert words[0] in command.commands, f"no command {words[0]}"
        command, words = command.commands[words[0]], words[1:]
    _, left, _ = command.make_parser(typer.Context(command, info_name="labrig")).parse_args(list(words))
    assert left == [], f"nothing takes {left}"


@pytest.mark.parametrize(
    "line", ["labrig cheque x", "labrig check x --rigg y", "labrig check x --rig", "labrig runs tags last"]
)
def test_a_wrong_command_would_be_found(line: str) -> None:
    """A misspelt command or option, and one without its value."""
    with pytest.raises((AssertionError, typer.TyperException)):
        _parse(line.split()[1:])


def test_every_page_that_a_message_names_exists() -> None:
    """In the hints of errors, and those that follow from the kind of an error or of a file."""
    hints = (path.read_text(encoding="utf-8") for path in (ROOT / "labrig").rglob("*.py"))
    named = {page for text in hints for page in re.findall(r"labrig manual ([a-z][\w-]*)", text)}
    named |= {*PAGES_OF_ERRORS.values(), *(page for _, page in PAGES_OF_FILES)}
    assert named - {place.rpartition("/")[2] for place in PAGES} == set()


@pytest.mark.parametrize("block", YAML.values(), ids=YAML)
def test_every_yaml_is_valid(block: Fence, lab_folder: Path, tmp_path: Path) -> None:
    """Put into the example file that it names, it is a protocol or a rig file."""
    (tmp_path / "block.yaml").write_text(block.text, encoding="utf-8")
    values = load_yaml_values(tmp_path / "block.yaml")
    kind, _, name = block.info.removeprefix("yaml").strip().partition("=")
    if kind:
        place = f"protocols/{name}.yaml" if kind == "protocol" else f"calibration/rig-{name}.yaml"
        merged = _merge(load_yaml_values(lab_folder / place), values)
        file = (lab_folder / place).with_stem(tmp_path.name)
        file.write_text(json.dumps(merged), encoding="utf-8")
        _ = load_protocol(file, list_usable_models()) if kind == "protocol" else load_rig(file)


def _merge(below: Plain, above: Plain) -> Plain:
    """Return a file with other values for some of its keys."""
    if not isinstance(below, dict) or not isinstance(above, dict):
        return above
    return {**below, **{key: _merge(below.get(key), value) for key, value in above.items()}}
