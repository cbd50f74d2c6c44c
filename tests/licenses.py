"""The licences of everything that labrig is installed with, as the packages state them; prints LICENSES.md.

make licenses
"""

import json
import re
from collections.abc import Iterable, Iterator
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
LOCK = ROOT / "tests" / "devices" / "outside_client" / "package-lock.json"
HEAD = """\
# Licences of what labrig is installed with

Written by `make licenses` from what each package states of itself; a test holds that it is current. labrig is under
BSD-3-Clause (`LICENSE`).

**python-can is under LGPL-3.0-only.** labrig imports it as it is published and contains nothing of it. Whoever passes
labrig on together with it, as an image or an installer, passes on its licence too and leaves it replaceable.

Published files of some packages contain libraries with licences of their own, which lie beside the packages:
opencv-python-headless contains FFmpeg (LGPL-2.1), shapely contains GEOS (LGPL-2.1), numpy and scipy contain OpenBLAS
(BSD-3-Clause) and GCC's libraries (GPL-3.0 with the runtime exception).
"""

# Not installed here: another platform needs it, or the extra `benchmark`.
ELSEWHERE = {
    "colorama": "BSD License",
    "ompl": "none stated; BSD-3-Clause in its sources",
    "tzdata": "Apache-2.0",
}


def read_pins(path: Path) -> dict[str, str]:
    """Return the version of each package of a constraints file, by its canonical name."""
    pins = re.findall(r"^([\w.-]+)==([^\s;\\]+)", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {canonicalize_name(name): version for name, version in pins}


def read_license(name: str) -> str:
    """Return the licence of an installed package: its expression, else its classifiers, else its own words."""
    found = metadata.metadata(name)
    classifiers = [text for text in found.get_all("Classifier") or () if text.startswith("License ::")]
    stated = [
        *(found.get_all("License-Expression") or ()),
        " AND ".join(text.rpartition(" :: ")[2] for text in classifiers),
        *(text.strip().partition("\n")[0] for text in found.get_all("License") or ()),
        "none stated",
    ]
    return next(filter(None, stated))


def find_needed(name: str, extras: Iterable[str] = ()) -> set[str]:
    """Return the canonical names of all that a package needs here, with those extras."""
    needed: set[str] = set()
    _add_needed(name, tuple(extras), needed)
    return needed - {canonicalize_name(name)}


def _add_needed(name: str, extras: tuple[str, ...], needed: set[str]) -> None:
    needed.add(canonicalize_name(name))
    for text in metadata.requires(name) or ():
        requirement = Requirement(text)
        wanted = requirement.marker is None or any(
            requirement.marker.evaluate({"extra": extra}) for extra in ("", *extras)
        )
        if wanted and (canonicalize_name(requirement.name) not in needed or requirement.extras):
            _add_needed(requirement.name, tuple(requirement.extras), needed)


def describe_licenses() -> str:
    """Return the text of LICENSES.md."""
    pins = read_pins(ROOT / "constraints-hashes.txt")
    licenses = {name: ELSEWHERE.get(name) or read_license(name) for name in pins}
    needed = find_needed("labrig")
    lock = json.loads(LOCK.read_text(encoding="utf-8"))["packages"]
    npm = {place.partition("node_modules/")[2]: found["license"] for place, found in lock.items() if place}
    return "\n".join(
        [
            HEAD,
            *_table("Needed to run labrig", {name: licenses[name] for name in pins if name in needed}),
            *_table(
                "Needed by its extras, its tests or another platform",
                {name: licenses[name] for name in pins if name not in needed},
            ),
            *_table("npm packages, for a test", npm),
        ]
    )


def _table(title: str, licenses: dict[str, str]) -> Iterator[str]:
    yield from (f"## {title}", "", "| package | licence |", "|---|---|")
    yield from (f"| {name} | {text} |" for name, text in licenses.items())
    yield ""


if __name__ == "__main__":
    (ROOT / "LICENSES.md").write_text(describe_licenses(), encoding="utf-8")
