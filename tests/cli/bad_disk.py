"""A labrig on a disk that once changes a bit of a file; arguments: the file, as named in a run, and a command line."""

import os
import sys
from pathlib import Path

from labrig.cli.main import run_command


def main(name: str, command: list[str]) -> int:
    """Change the file in the moment that `_find_file` waits for."""
    changed: list[Path] = []

    def spoil(event: str, arguments: tuple[object, ...]) -> None:
        file = None if changed else _find_file(name, event, arguments)
        if file is not None:
            changed.append(file)
            _flip_bit(file)

    sys.addaudithook(spoil)
    return run_command(command)


def _find_file(name: str, event: str, arguments: tuple[object, ...]) -> Path | None:
    """Return the file to change once its run's sums are renamed into place, or once a copy of it is read back.

    The manifest is written after the sums: it is changed as it is renamed itself, chain and sums as it is.
    """
    if event == "os.rename":
        source, target = Path(str(arguments[0])), Path(str(arguments[1]))
        run, closes = target.parent, (target.parent / "SHA256SUMS").exists()
        if name in {"manifest.json", "chain.jsonl", "SHA256SUMS"}:
            changed = source if name == "manifest.json" else run / name
            return changed if target.name == "manifest.json" and closes else None
        return run / name if target.name == "SHA256SUMS" else None
    if event != "open" or int(str(arguments[2])) & os.O_ACCMODE != os.O_RDONLY:
        return None
    path = str(arguments[0])
    return Path(path) if path.endswith(f"/{name}") and "/.copy-" in path else None


def _flip_bit(path: Path) -> None:
    with path.open("r+b") as file:
        content = file.read()
        middle = len(content) // 2
        file.seek(middle)
        file.write(bytes([content[middle] ^ 1]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2:]))
