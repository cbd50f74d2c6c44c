"""`labrig manual`: which page is opened."""

from pathlib import Path

import pytest

from labrig.cli.manual import find_pages, read_title
from tests.cli.conftest import Labrig


def test_all_pages_are_listed(labrig: Labrig) -> None:
    """Each with its title; as JSON too."""
    listed = {row["topic"]: row["title"] for row in labrig("manual", "--json").json()}
    assert listed == {name: read_title(page) for name, page in find_pages().items()}
    assert all(title in labrig("manual").out for title in listed.values())


@pytest.mark.parametrize("asked", [["run-format"], ["format", "run"]])
def test_a_page_is_named_or_known_by_words_of_its_title(asked: list[str], labrig: Labrig) -> None:
    """Where the site was not built its source is named."""
    done = labrig("manual", *asked, "--json").json()
    assert (done["topic"], Path(done["page"]).suffix) == ("run-format", ".md")
    assert labrig("manual", *asked).out.strip() == done["page"]


def test_what_is_no_page_is_refused_with_those_that_are_near(labrig: Labrig) -> None:
    """A misspelt name, and a word that several titles share."""
    refused = labrig("manual", "run-formt")
    assert (refused.exit_code, "run-format" in refused.err) == (2, True)
