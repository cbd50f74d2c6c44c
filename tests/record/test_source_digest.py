"""The digest that says which code made a record."""

import hashlib
from pathlib import Path

from labrig.record.source_digest import digest_sources


def _write(package: Path, name: str, content: bytes) -> None:
    path = package / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)


def test_the_digest_is_that_of_a_listing_by_sha256sum(tmp_path: Path) -> None:
    """Anybody can compute it again; what is no code does not count, wherever it stands."""
    code = {"a.py": b"1", "b/page.html.jinja": b"2", "b.py": b"3"}
    other = {
        "b/__pycache__/a.py": b"4",
        "examples/x.svg": b"5",
        "manual/example/y.py": b"6",
        "read.md": b"7",
    }
    for name, content in (*code.items(), *other.items()):
        _write(tmp_path, name, content)
    listing = "".join(f"{hashlib.sha256(code[name]).hexdigest()}  {name}\n" for name in sorted(code))
    assert digest_sources(tmp_path) == hashlib.sha256(listing.encode()).hexdigest()
