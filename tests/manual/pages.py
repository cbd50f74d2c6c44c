"""The pages of the manual and the README, with their blocks of code.

What stands behind an opening fence says what becomes of the block:

- `sh`: its lines run as they stand, in order, in one lab folder for each page; `# exit code 1` at the end of a line
  says how it ends if not with 0;
- `sh bench`: needs hardware, a person, a display or the network; every command and option in it is looked up;
- `yaml protocol=NAME`, `yaml rig=NAME`: validated together with the rest of that example file;
- `yaml`: is read; `python`: runs; `text`: is shown by a program; `{literalinclude}`: is a file of the example package.
"""

import re
from dataclasses import dataclass
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token

from labrig.cli.manual import SOURCE, find_pages

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
PAGES = {page.relative_to(SOURCE).with_suffix("").as_posix(): page for page in find_pages().values()}
KINDS = re.compile(
    r"sh|sh bench|yaml|yaml (?:protocol|rig)=[\w-]+|python|text|\{toctree\}|\{literalinclude\} \S+"
)


@dataclass(frozen=True)
class Fence:
    """A block of code: the words behind its opening fence, its text, and its line in the page, counted from 1."""

    info: str
    text: str
    line: int


@dataclass(frozen=True)
class Line:
    """A line of a block for a shell: the command, and the exit code that it is said to end with."""

    command: str
    exit_code: int


def parse(text: str) -> list[Token]:
    """Return the tokens of a text."""
    return MarkdownIt("commonmark", {"html": False}).enable("table").parse(text)


def list_blocks(page: Path, *kinds: str) -> list[Fence]:
    """Return the blocks of a page that are of these kinds, or all."""
    found = [
        Fence(token.info.strip(), token.content, token.map[0] + 1)
        for token in parse(page.read_text(encoding="utf-8"))
        if token.type == "fence" and token.map is not None
    ]
    return [fence for fence in found if not kinds or fence.info in kinds]


def list_lines(block: Fence) -> list[Line]:
    """Return the lines of a block for a shell; one that ends with a backslash goes on in the next."""
    lines = (line.strip() for line in block.text.replace("\\\n", " ").splitlines())
    return [_read_line(line) for line in lines if line and not line.startswith("#")]


def _read_line(line: str) -> Line:
    command, mark, code = re.match(r"(.*?)(?:\s+(# exit code )(\d+))?$", line).groups()
    return Line(command, int(code) if mark else 0)
