"""Changes of a record that cover their traces: checksums, hashes and the chain made to fit again."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

from labrig.record.chain import encode_link, hash_link
from labrig.record.json_lines import decode_line, encode_line
from labrig.record.layout import CHAIN, FRAME_LINES, MANIFEST, SHA256SUMS
from labrig.record.opening import encode_manifest


def edit_manifest(run: Path, **changes: object) -> None:
    """Change values of the manifest and give it a checksum that fits."""
    manifest = json.loads((run / MANIFEST).read_bytes()) | changes
    manifest.pop("crc32")
    (run / MANIFEST).write_bytes(encode_manifest(manifest))


def edit_line(path: Path, number: int, **changes: object) -> None:
    """Change a line, counted from 1, and give it a checksum that fits."""
    lines = path.read_bytes().splitlines()
    lines[number - 1] = encode_line(decode_line(lines[number - 1]) | changes).rstrip(b"\n")
    path.write_bytes(b"\n".join(lines) + b"\n")


def redo_hashes(run: Path) -> None:
    """Make every hash of the record fit its files again, but not the chain."""
    _redo_pictures(run)
    _redo_manifest(run)
    sums = (run / SHA256SUMS).read_text().splitlines()
    names = [line[66:] for line in sums if line[64:66] == "  " and (run / line[66:]).is_file()]
    (run / SHA256SUMS).write_text("".join(f"{_hash(run / name)}  {name}\n" for name in names))


def redo_chain(run: Path) -> None:
    """Write the chain anew over the files as they are now."""
    previous: str | None = None
    links: list[bytes] = []
    for number, line in enumerate((run / CHAIN).read_bytes().splitlines(), start=1):
        link = json.loads(line)
        if number == 2:
            _point_at_first_link(run, hash_link(links[0]))
        lengths = {name: (run / name).stat().st_size for name in link.get("bytes", {})}
        files = {name: _hash(run / name) for name in link["files"] if (run / name).is_file()}
        links.append(encode_link(number, link["kind"], link["at"], files, lengths, previous))
        previous = hash_link(links[-1])
    (run / CHAIN).write_bytes(b"".join(links))


def _redo_pictures(run: Path) -> None:
    for number, line in enumerate((run / FRAME_LINES).read_bytes().splitlines(), start=1):
        fields = decode_line(line)
        path = run / str(fields.get("file"))
        if "offset" not in fields and path.is_file() and _hash(path) != fields.get("sha256"):
            edit_line(run / FRAME_LINES, number, sha256=_hash(path))


def _redo_manifest(run: Path) -> None:
    hashes = dict(json.loads((run / MANIFEST).read_bytes())["hashes"])
    single = {"protocol_sha256": "protocol.yaml", "rig_sha256": "rig.yaml", "code_diff_sha256": "code.diff"}
    hashes |= {
        key: _hash(run / name) for key, name in single.items() if hashes.get(key) and (run / name).is_file()
    }
    hashes["calibration"] = {
        path.name: _hash(path) for path in sorted((run / "calibration").iterdir()) if path.is_file()
    }
    edit_manifest(run, hashes=hashes)


def _point_at_first_link(run: Path, sha256: str) -> None:
    hashes: Mapping[str, object] = json.loads((run / MANIFEST).read_bytes())["hashes"]
    edit_manifest(run, hashes={**hashes, "first_link_sha256": sha256})


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
