"""What labrig is installed from: every version is pinned, and no index is named."""

import json
import re
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
LOCK = ROOT / "tests" / "devices" / "outside_client" / "package-lock.json"
PINS = ROOT / "constraints.txt"


def _find_needed(*extras: str) -> set[str]:
    """Return the canonical names of all that labrig needs here, with those extras."""
    needed: set[str] = set()
    _add_needed("labrig", extras, needed)
    return needed - {"labrig"}


def _add_needed(name: str, extras: tuple[str, ...], needed: set[str]) -> None:
    needed.add(canonicalize_name(name))
    for text in metadata.requires(name) or ():
        requirement = Requirement(text)
        wanted = requirement.marker is None or any(
            requirement.marker.evaluate({"extra": extra}) for extra in ("", *extras)
        )
        if wanted and (canonicalize_name(requirement.name) not in needed or requirement.extras):
            _add_needed(requirement.name, tuple(requirement.extras), needed)


def test_all_that_labrig_needs_is_pinned() -> None:
    """What labrig and its development need, whoever asks for it, is in constraints.txt."""
    pins = re.findall(r"^([\w.-]+)==", PINS.read_text(encoding="utf-8"), re.MULTILINE)
    assert _find_needed("dev", "testing") <= set(map(canonicalize_name, pins))


def test_no_file_of_pins_names_an_index() -> None:
    """Where packages come from is the business of whoever installs them."""
    for file in (PINS, LOCK, LOCK.with_name("package.json"), ROOT / "Makefile"):
        found = re.findall(r"https?://|--(?:extra-)?index-url|--find-links", file.read_text(encoding="utf-8"))
        assert found == [], file


def test_the_outside_client_is_pinned_by_integrity() -> None:
    """Each npm package of the client has one version and its SHA-512, and no address."""
    packages = json.loads(LOCK.read_text(encoding="utf-8"))["packages"]
    wanted = json.loads(LOCK.with_name("package.json").read_text(encoding="utf-8"))["dependencies"]
    assert packages.pop("")["dependencies"] == wanted
    assert packages["node_modules/canopen"]["version"] == wanted["canopen"]
    for place, package in packages.items():
        assert package["integrity"].startswith("sha512-"), place
        assert "resolved" not in package, place


def test_a_copyleft_licence_comes_with_one_package() -> None:
    """Of the packages that labrig runs with, python-can alone has one, and the README says so."""
    copyleft = {
        name for name in _find_needed() if re.search(r"GPL|Mozilla|MPL|EPL|CDDL", _read_license(name))
    }
    assert copyleft == {"python-can"}
    assert metadata.metadata("python-can")["License-Expression"] == "LGPL-3.0-only"
    assert "LGPL-3.0-only" in (ROOT / "README.md").read_text(encoding="utf-8")


def _read_license(name: str) -> str:
    """Return what an installed package states of its licence, in its expression, its classifiers or its own words."""
    found = metadata.metadata(name)
    classifiers = [text for text in found.get_all("Classifier") or () if text.startswith("License ::")]
    stated = [*(found.get_all("License-Expression") or ()), *classifiers]
    return " ".join(stated or [text.partition("\n")[0] for text in found.get_all("License") or ()])


def test_nobody_is_told_to_install_labrig_from_an_index() -> None:
    """labrig is on no index: what stands there under its name, now or later, is somebody else's."""
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "labrig").rglob("*.md")]
    offenders = [
        f"{file}: {found.group()}"
        for file in (*pages, *(ROOT / "labrig").rglob("*.py"))
        for found in re.finditer(r"pip install ['\"]?labrig[^\w`]", file.read_text(encoding="utf-8"))
    ]
    assert offenders == []
