"""Sentences of the README and the manual are short: a median of at most 15 words, and 90 % of at most 25."""

import pytest

from labrig.report.manual import KINDS, ManualPage, read_written_pages
from tests.manual.pages import README
from tests.manual.readability import Readability, count_words, list_sentences, measure, split_sentences

WRITTEN = read_written_pages()
GROUPS = {
    "README": [README],
    **{kind: [page for page in WRITTEN if page.kind == kind] for kind in KINDS},
}


@pytest.mark.parametrize(
    ("paragraph", "words"),
    [
        ("The needle moves. It stops (see below). Why?", [3, 4, 1]),
        ("Use a rig, e.g. A or B, by A. Person: 3.5 mm of gel. labrig holds 13 % of gelatin.", [14, 5]),
        ("See `labrig check`, which says so; nothing moves", [8]),
    ],
)
def test_sentences_are_split_and_words_counted(paragraph: str, words: list[int]) -> None:
    """Abbreviations, initials and decimals end no sentence; a sign alone is no word."""
    assert [count_words(sentence) for sentence in split_sentences(paragraph)] == words


def test_long_sentences_are_not_good() -> None:
    """Neither a long median nor many long sentences pass; headings, tables and code do not count."""
    long, short = " ".join(["word"] * 30) + ".", "A short one."
    text = f"# {long}\n\n| {long} |\n|---|\n\n```text\n{long}\n```\n\n" + f"{short} " * 8 + f"{long} " * 2
    assert measure(list_sentences([ManualPage("x", "x", lambda: text)])) == Readability(10, 3, 0.8)
    assert not Readability(10, 3, 0.8).is_good
    assert not Readability(10, 15.5, 1.0).is_good
    assert Readability(10, 15, 0.9).is_good


@pytest.mark.parametrize("group", [group for group, pages in GROUPS.items() if pages])
def test_sentences_are_short(group: str) -> None:
    """In each group of pages; prints the figures."""
    sentences = list_sentences(GROUPS[group])
    found = measure(sentences)
    print(f"{group}: {found}")  # noqa: T201 - the figures, with -s
    longest = sorted(sentences, key=count_words)[-3:]
    assert found.is_good, (found, longest)
