"""`labrig manual`: pages in the terminal, in a browser and as files."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from labrig.cli.command_reference import find_commands, read_tree
from labrig.cli.main import app
from labrig.cli.manual import find_page, list_pages
from labrig.errors import InputError
from labrig.report.manual import KINDS, ManualPage
from tests.cli.conftest import Labrig

PLACES = [page.place for page in list_pages()]


def _run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    kept = {name: value for name, value in os.environ.items() if name not in {"DISPLAY", "WAYLAND_DISPLAY"}}
    return subprocess.run(
        [sys.executable, "-m", "labrig", "manual", *arguments],
        env={**kept, "NO_COLOR": "1", **environment}, capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip


def test_all_pages_are_listed(labrig: Labrig) -> None:
    """By kind, each with its title; as JSON too."""
    lines = labrig("manual").out.splitlines()
    listed = labrig("manual", "--json").json()
    assert [row["topic"] for row in listed] == [place.rpartition("/")[2] for place in PLACES]
    for row in listed:
        if row["kind"] is not None:
            assert any(line.split()[:1] == [row["topic"]] and row["title"] in line for line in lines), row
            assert KINDS[row["kind"]] in lines


def test_a_command_can_be_copied_from_the_terminal() -> None:
    """A line of code is printed as one line, however narrow the terminal is."""
    page = find_page(list_pages(), "first-run").read()
    command = next(line for line in page.splitlines() if len(line) > 120 and line.startswith("labrig run"))
    printed = _run("first-run", "--print", COLUMNS="40").stdout.splitlines()
    assert f" {command}" in printed


_PAGES = [
    ManualPage(place, title, str)
    for place, title in (
        ("index", "The manual"),
        ("howto/rig", "Describe a rig"),
        ("reference/rig", "Rig files"),
    )
]


@pytest.mark.parametrize(
    ("asked", "hint"),
    [
        ("idnex", "did you mean index?"),
        ("zzz", "known here: index, rig"),
        ("rig", "name one: howto/rig, reference/rig"),
        ("RI", "name one: howto/rig, reference/rig"),
    ],
)
def test_a_page_that_cannot_be_told_is_refused(asked: str, hint: str) -> None:
    """The hint names what may be meant."""
    with pytest.raises(InputError) as refused:
        find_page(_PAGES, asked)
    assert refused.value.hint == hint


@pytest.mark.parametrize("asked", ["reference/rig", "Rig files", "files", "reference/RIG.md"])
def test_a_page_is_found_by_its_name_or_by_words_of_its_title(asked: str) -> None:
    """In any case of letters."""
    assert find_page(_PAGES, asked).place == "reference/rig"


def test_an_unknown_page_ends_with_2(labrig: Labrig) -> None:
    """The words of the command line are one question."""
    done = labrig("manual", "no", "such", "page")
    assert (done.exit_code, "the manual has no page 'no such page'" in done.err) == (2, True)


def test_a_browser_shows_the_page_where_there_is_a_display(tmp_path: Path) -> None:
    """It is given a file of this computer with the page; without a display, or with --print, the page is printed.

    Its path is told whatever the browser does with it, and not that it was opened.
    """
    browser, told = tmp_path / "browser", tmp_path / "told"
    browser.write_text(f'#!/bin/sh\nprintf %s "$1" > "{told}"\n', encoding="utf-8")
    browser.chmod(0o755)
    environment = {"BROWSER": str(browser), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    for arguments, display in ((("Rig", "files"), ""), (("reference/rig", "--print"), ":7")):
        printed = _run(*arguments, DISPLAY=display, **environment)
        assert (printed.returncode, "Rig files" in printed.stdout, told.exists()) == (0, True, False)
    done = _run("reference/rig", DISPLAY=":7", **environment)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
    file = Path(told.read_text(encoding="utf-8").removeprefix("file://"))
    assert file == tmp_path / "cache" / "labrig" / "manual" / "reference" / "rig.html"
    assert "quick_stop_deceleration" in file.read_text(encoding="utf-8")
    # After a browser that fails, Python tries the others of PATH.
    failed = _run(
        "reference/rig", DISPLAY=":7", **environment | {"BROWSER": shutil.which("false"), "PATH": ""}
    )
    assert (failed.returncode, "Rig files" in failed.stdout) == (0, True)
    assert done.stderr == failed.stderr == f"the page is {file}; --print prints it here\n"


def test_all_pages_are_written_as_files(labrig: Labrig, tmp_path: Path) -> None:
    """An existing folder is refused without --force."""
    for force, exit_code in ((), 0), ((), 2), (("--force",), 0):
        assert labrig("manual", "--html", tmp_path / "pages", *force).exit_code == exit_code
    written = {path.relative_to(tmp_path / "pages").as_posix() for path in tmp_path.rglob("*.html")}
    assert written == {f"{place}.html" for place in PLACES}


def test_the_reference_names_every_command_and_option(labrig: Labrig) -> None:
    """With the exit codes of every kind of failure."""
    text = labrig("manual", "commands", "--json").json()["text"]
    sections = {part.partition("`\n")[0]: part for part in text.split("\n## `")[1:]}
    commands = dict(find_commands(read_tree(app)))
    assert {" ".join(path) for path in commands} == sections.keys()
    assert len(commands) > 30
    for path, command in commands.items():
        for name in (name for param in command.params for name in param.opts if name.startswith("--")):
            assert name in sections[" ".join(path)], (path, name)
    for code in (0, 1, 2, 3, 4, 5, 130):
        assert f"\n| {code} | " in text
