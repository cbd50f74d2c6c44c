"""A labrig on a disk that once changes a bit of a file; arguments: the file, as named in a run, and a command line."""

import sys
from pathlib import Path

from labrig.cli.main import run_command


def main(name: str, command: list[str]) -> int:
    """Change the file when the sums of its run are renamed into place; the manifest when it is itself, after these."""
    files: list[Path] = []

    def spoil(event: str, arguments: tuple[object, ...]) -> None:
        if event != "os.rename" or files:
            return
        source, target = Path(str(arguments[0])), Path(str(arguments[1]))
        if target.name == "SHA256SUMS" and name != "manifest.json":
            files.append(target.parent / name)
        elif target.name == name and (target.parent / "SHA256SUMS").exists():
            files.append(source)
        for file in files:
            _flip_bit(file)

    sys.addaudithook(spoil)
    return run_command(command)


def _flip_bit(path: Path) -> None:
    with path.open("r+b") as file:
        content = file.read()
        middle = len(content) // 2
        file.seek(middle)
        file.write(bytes([content[middle] ^ 1]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2:]))
