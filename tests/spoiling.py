"""Spoils the content of a file: bytes at random, or words, numbers and lines of a text."""

import random
import re

HOSTILE = (
    "", "null", "~", "true", "-1", "0", "1.5", "1e308", "1e999", "NaN", ".nan", "-Infinity", "9" * 400, '"x"', '""',
    '"\\ud800"', '"\\u0000"', '"../../x"', "<script>", f'"{"é" * 3000}"', "[]", "{}", "[null]", "{a: 1}", "[1, 2, 3]",
    "[" * 70 + "]" * 70, "[" * 20_000, "'", "&a [*a]", "!!python/object x", "|", "- - -", "? a", "a: b: c", "---",
    "2026-02-30", "1:30", "0o777", "<<: *a", "/dev/zero", "\ufeff", "²",
)  # fmt: skip
_BYTES = (
    b"",
    b"\0",
    b"\xff\xfe",
    b"\xed\xa0\x80",
    b"\r",
    b"\t",
    b"\x1b[2J",
    b"{" * 5000,
    b'"',
    b"\\",
    b",",
    b"-",
)
_WORD = re.compile(r'"(?:[^"\\]|\\.)*"|[\w.+-]+')


def spoil(rng: random.Random, content: bytes) -> bytes:
    """Return the content with a few places changed; a text mostly by its values, so that readers get far into it."""
    text = _decode(content)
    for _ in range(rng.choice((1, 1, 1, 3))):
        if text is not None and rng.random() < 0.7:
            text = _spoil_text(rng, text)
            content = text.encode("utf-8", "surrogatepass")
        else:
            content = _spoil_bytes(rng, content)
            text = _decode(content)
    return content


def _decode(content: bytes) -> str | None:
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        return None


def _spoil_text(rng: random.Random, text: str) -> str:
    lines = text.split("\n")
    place = rng.randrange(len(lines))
    match rng.randrange(6):
        case 0:
            del lines[place]
        case 1:
            lines.insert(place, rng.choice((lines[place], *HOSTILE)))
        case _:
            words = list(_WORD.finditer(lines[place]))
            if words:
                word = rng.choice(words)
                lines[place] = (
                    f"{lines[place][: word.start()]}{rng.choice(HOSTILE)}{lines[place][word.end() :]}"
                )
    return "\n".join(lines)


def _spoil_bytes(rng: random.Random, content: bytes) -> bytes:
    start, end = sorted(rng.randrange(len(content) + 1) for _ in range(2))
    end = min(end, start + rng.choice((1, 4, 100, 10**9)))
    match rng.randrange(5):
        case 0 | 1 if content:
            start = min(start, len(content) - 1)
            return content[:start] + bytes([content[start] ^ 1 << rng.randrange(8)]) + content[start + 1 :]
        case 2:
            return content[:start]
        case 3:
            return content[:start] + content[end:]
        case _:
            return content[:start] + rng.choice(_BYTES) + content[end:]
