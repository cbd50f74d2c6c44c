"""How long the sentences of a text are."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from tests.manual.pages import find_prose

MEDIAN_WORDS, LONGEST_OF_90_PERCENT = 15, 25

# A point behind these, or behind a capital letter alone, ends no sentence.
_ABBREVIATIONS = ("e.g.", "i.e.", "vs.", "approx.", "No.", "Fig.", "Eq.", "Sec.", "al.")
_END = re.compile(r"(?<!\.)[.!?][\"')\]]*\s+")


def split_sentences(paragraph: str) -> list[str]:
    """Return the sentences of a paragraph without markup."""
    sentences, start = [], 0
    for end in _END.finditer(paragraph):
        last = paragraph[start : end.end()].rsplit(maxsplit=1)[-1]
        if not last.endswith(_ABBREVIATIONS) and not re.fullmatch(r"[A-Z]\.", last):
            sentences.append(paragraph[start : end.end()].strip())
            start = end.end()
    return [*sentences, rest] if (rest := paragraph[start:].strip()) else sentences


def count_words(sentence: str) -> int:
    """Count what stands between spaces and has a letter or a digit."""
    return sum(bool(re.search(r"\w", word)) for word in sentence.split())


@dataclass(frozen=True)
class Readability:
    """The median length of sentences in words, and the share of 25 words or less."""

    median_words: float
    share_short: float

    @property
    def is_good(self) -> bool:
        """Whether both are within their limits."""
        return self.median_words <= MEDIAN_WORDS and self.share_short >= 0.9


def list_sentences(text: str) -> list[str]:
    """Return the sentences of the prose of a page; headings, tables and code are none."""
    return [
        sentence
        for paragraph in find_prose(text)
        for sentence in split_sentences(paragraph)
        if count_words(sentence)
    ]


def measure(sentences: Sequence[str]) -> Readability:
    """Return the figures of sentences."""
    words = [count_words(sentence) for sentence in sentences]
    return Readability(median(words), sum(count <= LONGEST_OF_90_PERCENT for count in words) / len(words))
