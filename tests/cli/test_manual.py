"""`labrig manual`: which page is opened."""

from pathlib import Path

import pytest

from labrig.cli.manual import find_pages, read_title
from tests.cli.conftest import Labrig


def test_all_pages_are_listed(labrig: Labrig) -> None:
    """Each with its title."""
    listed = [line.split(maxsplit=1) for line in labrig("manual").out.splitlines()[1:]]
    assert listed == [[name, read_title(page)] for name, page in find_pages().items()]


@pytest.mark.parametrize("asked", [["run-format"], ["format", "run"]])
def test_a_page_is_named_or_known_by_words_of_its_title(asked: list[str], labrig: Labrig) -> None:
    """Where the site was not built its source is named."""
    assert Path(labrig("manual", *asked).out.strip()) == find_pages()["run-format"]
