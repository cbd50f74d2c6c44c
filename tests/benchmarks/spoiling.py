"""Ways to spoil a file: bytes at random, or its values."""

import json
import random
import re
from collections.abc import Callable, Sequence
from typing import Any

Spoil = Callable[[random.Random, bytes], bytes]

_DEEP = 20_000
HOSTILE_JSON = (
    "null", "true", "0", "-1", "1.5", "1e308", "1e999", "NaN", "-Infinity", "9" * 400, str(2**63),
    str(-(2**63)), '""', '"x"', '"nan"', '"\\ud800"', '"\\u0000"', '"../../x"', '"<script>"', f'"{"é" * 3000}"',
    "[]", "{}", "[null]", "[[]]", '{"a": 1, "a": 2}', "[1, 2, 3]", '["a", "b"]', "[" * 70 + "]" * 70,
    "[" * _DEEP + "]" * _DEEP, "[" * _DEEP, "1 2", "'x'",
)  # fmt: skip
HOSTILE_YAML = (
    "", "null", "~", "yes", "0", "-1", "1e308", "1e999", ".nan", ".inf", "-.inf", "9" * 400,
    "0x7fffffffffffffff", "''", "x", "nan", "[]", "{}", "[1, 2]", "{a: 1}", "&a 1", "*a", "&a [*a]",
    "!!python/object x", "|", ">", "'", '"', '"\\ud800"', "é" * 3000, "[" * 30 + "]" * 30, "[" * 5000, "- - -",
    "? a", "a: b: c", "%YAML", "---", "2026-02-30", "1_000", "../../x", "/dev/zero", "[" + "1," * 30_000 + "]",
    '"\\0"', "1:30", "0o777", "<<: *a",
)  # fmt: skip
_PIECES = (
    b"", b"\0", b"\xff", b"\xef\xbb\xbf", b"\xff\xfe", b"\xe9", b"\xed\xa0\x80", b"\n", b"\r", b"\t",
    b"\x1b[2J", b"9" * 400, b"nan", b"[" * 5000, b"{" * 5000, b'"', b"\\", b",", b"-", b"\xf0\x9f\x98\x80",
    b"\x7f" * 300,
)  # fmt: skip
_MARK = '"@spoilt@"'


def spoil_bytes(rng: random.Random, content: bytes) -> bytes:
    """Flip bits, cut, repeat, replace or insert bytes; some files become empty or another kind of text."""
    for _ in range(rng.choice((1, 1, 1, 2, 5, 40))):
        place, end = sorted(rng.randrange(len(content) + 1) for _ in range(2))
        end = min(end, place + rng.choice((1, 4, 100, 10**9)))
        match rng.randrange(8):
            case 0 | 1 | 2 if content:
                place = min(place, len(content) - 1)
                content = (
                    content[:place] + bytes([content[place] ^ 1 << rng.randrange(8)]) + content[place + 1 :]
                )
            case 3:
                content = content[:place]
            case 4:
                content = content[:place] + content[end:]
            case 5:
                content = content[:end] + content[place:]
            case 6:
                content = content[:place] + rng.choice(_PIECES) + content[end:]
            case _:
                content = (
                    content[:place] + rng.randbytes(end - place if end - place < 4096 else 64) + content[end:]
                )
    if rng.random() < 0.02:
        text = content.decode("utf-8", "replace")
        return rng.choice((b"", b"\0" * 5000, text.encode("utf-16"), text.encode("latin-1", "replace")))
    return content


def spoil_json(rng: random.Random, content: bytes) -> bytes:
    """Replace, delete, repeat or add values of a JSON document."""
    return _spoil_value(rng, json.loads(content)).encode()


def spoil_lines(rng: random.Random, content: bytes) -> bytes:
    """Spoil values of lines; or delete, repeat or exchange lines."""
    lines = content.splitlines()
    for _ in range(rng.choice((1, 1, 3))):
        place, other = (rng.randrange(len(lines)) for _ in range(2)) if lines else (0, 0)
        match rng.randrange(8) if lines else 0:
            case 0:
                lines.insert(place, encode_line("{" + rng.choice(('"kind":"x"', '"t_s":1', '"a":{}')) + "}"))
            case 1:
                del lines[place]
            case 2:
                lines[place], lines[other] = lines[other], lines[place]
            case _:
                try:
                    fields = json.loads(lines[place])
                except (ValueError, RecursionError):  # spoilt before
                    continue
                lines[place] = encode_line(_spoil_value(rng, fields))
    return b"".join(line + b"\n" for line in lines)


def encode_line(body: str) -> bytes:
    """Return a line of a record with this JSON object, which need not be one."""
    return body.encode("utf-8", "backslashreplace")


def spoil_yaml(rng: random.Random, content: bytes) -> bytes:
    """Replace values and keys, delete, repeat or indent lines."""
    lines = content.decode().splitlines()
    for _ in range(rng.choice((1, 1, 1, 3))):
        place = rng.randrange(len(lines)) if lines else 0
        match rng.randrange(8) if lines else 0:
            case 0:
                lines.insert(place, rng.choice((*HOSTILE_YAML, "experiment: x", "unknown_key: 1")))
            case 1:
                del lines[place]
            case 2:
                lines.insert(place, lines[place])
            case 3:
                lines[place] = " " * rng.randrange(5) + lines[place].lstrip()
            case _:
                hostile = rng.choice(HOSTILE_YAML)
                found = re.search(r"(:|-)(\s+|$)[^:]*$", lines[place])
                lines[place] = f"{lines[place][: found.end(1)] if found else ''} {hostile}"
    return "\n".join(lines).encode("utf-8", "surrogatepass")


def spoil_text(rng: random.Random, content: bytes) -> bytes:
    """Replace words and numbers of a text, or lines."""
    words = re.split(rb"([\s,=:#\[\]]+)", content)
    for _ in range(rng.choice((1, 2, 5))):
        words[rng.randrange(len(words))] = rng.choice(
            (*_PIECES, b"1e999", b"-1", b"0x", b"[", b"99999999999", "²".encode())
        )
    return b"".join(words)


def mixed(spoil: Spoil) -> Spoil:
    """Return a way to spoil a file by its values, or, for a third of the files, by its bytes."""
    return lambda rng, content: (spoil if rng.random() < 0.67 else spoil_bytes)(rng, content)


def _spoil_value(rng: random.Random, document: Any) -> str:
    """Return the text of a document of which one value, or a few, are spoilt."""
    raw: list[str] = []
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        holder, key = _choose_place(rng, document)
        if holder is None:
            return rng.choice(HOSTILE_JSON)
        match rng.randrange(6):
            case 0:
                del holder[key]
            case 1 if isinstance(holder, dict):
                holder[rng.choice(("x", "", "\ud800", "kind"))] = holder.pop(key)
            case 2 if isinstance(holder, dict):
                raw.append(json.dumps(holder[key]) + f", {json.dumps(key)}: {rng.choice(HOSTILE_JSON)}")
                holder[key] = _MARK[1:-1]
            case _:
                raw.append(rng.choice(HOSTILE_JSON))
                holder[key] = _MARK[1:-1]
    # Values that were marked and then deleted leave texts over.
    texts = iter(raw)
    return re.sub(re.escape(_MARK), lambda _: next(texts, "null"), json.dumps(document))


def _choose_place(rng: random.Random, document: Any) -> tuple[Any, Any]:
    """Return a list or mapping of the document and a key in it, each level equally likely."""
    holder, key = None, None
    while isinstance(document, dict | list) and document and (holder is None or rng.random() < 0.75):
        keys: Sequence[Any] = list(document) if isinstance(document, dict) else range(len(document))
        holder, key = document, rng.choice(keys)
        document = document[key]
    return holder, key
