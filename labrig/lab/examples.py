"""The files that labrig brings for a new lab folder: protocols, rig files, calibration, schemas."""

import tomllib
from collections.abc import Iterator
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

_FILES = "labrig/lab/files"
_CHECKOUT = Path(__file__).parents[2]


def read_examples() -> dict[str, bytes]:
    """Return the content of each example by its place in a lab folder, such as `protocols/steerability.yaml`."""
    return {place: file.read_bytes() for place, file in sorted(find_examples().items())}


def find_examples() -> dict[str, Traversable]:
    """Return the examples by their place in a lab folder: those in the installed package, or those of the checkout."""
    packed = resources.files("labrig.lab") / "files"
    return dict(_walk(packed)) if packed.is_dir() else _list_in_checkout(_CHECKOUT)


def _walk(folder: Traversable, above: str = "") -> Iterator[tuple[str, Traversable]]:
    for entry in folder.iterdir():
        place = f"{above}{entry.name}"
        if entry.is_dir():
            yield from _walk(entry, f"{place}/")
        else:
            yield place, entry


def _list_in_checkout(checkout: Path) -> dict[str, Traversable]:
    """Return the files that a wheel would hold: those that `pyproject.toml` includes from outside of the package."""
    project = tomllib.loads((checkout / "pyproject.toml").read_text(encoding="utf-8"))
    included = project["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    return {place.removeprefix(f"{_FILES}/"): checkout / source for source, place in included.items()}
