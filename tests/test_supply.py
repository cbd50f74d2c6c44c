"""What labrig is installed from: every file is pinned by a hash, every licence is listed, and no index is named."""

import json
import re
import sys
from importlib import metadata

import pytest

from tests.licenses import LOCK, ROOT, describe_licenses, find_needed, read_license, read_pins

HASHES = ROOT / "constraints-hashes.txt"


def test_every_pinned_version_has_hashes() -> None:
    """constraints-hashes.txt has the versions of constraints.txt, and one or more SHA-256 for each of its packages."""
    hashed = read_pins(HASHES)
    pinned = read_pins(ROOT / "constraints.txt")
    assert {name: hashed.get(name) for name in pinned} == pinned
    text = re.sub(r"(?m)^#.*\n", "", HASHES.read_text(encoding="utf-8"))
    entries = text.replace("\\\n", "").splitlines()
    assert len(entries) == len(hashed)
    for entry in entries:
        assert re.fullmatch(r"[\w.-]+==\S+( ; [^\\]+?)?\s+(--hash=sha256:[0-9a-f]{64}\s*)+", entry), entry


def test_all_that_labrig_needs_is_pinned() -> None:
    """What labrig and its development need, whoever asks for it, is in constraints.txt."""
    assert find_needed("labrig", ("dev", "testing")) <= read_pins(ROOT / "constraints.txt").keys()


def test_no_file_of_pins_names_an_index() -> None:
    """Where packages come from is the business of whoever installs them."""
    for file in (HASHES, ROOT / "constraints.txt", LOCK, LOCK.with_name("package.json"), ROOT / "Makefile"):
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


@pytest.mark.skipif(sys.platform != "linux", reason="other platforms need other packages")
def test_every_licence_is_listed() -> None:
    """LICENSES.md says what the installed packages say; after a change: make licenses."""
    assert (ROOT / "LICENSES.md").read_text(encoding="utf-8") == describe_licenses()


def test_a_copyleft_licence_comes_with_one_package() -> None:
    """Of the packages that labrig runs with, python-can alone has one, and the README says so."""
    copyleft = {
        name for name in find_needed("labrig") if re.search(r"GPL|Mozilla|MPL|EPL|CDDL", read_license(name))
    }
    assert copyleft == {"python-can"}
    assert metadata.metadata("python-can")["License-Expression"] == "LGPL-3.0-only"
    assert "LGPL-3.0-only" in (ROOT / "README.md").read_text(encoding="utf-8")


def test_nobody_is_told_to_install_labrig_from_an_index() -> None:
    """labrig is on no index: what stands there under its name, now or later, is somebody else's."""
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "labrig").rglob("*.md")]
    offenders = [
        f"{file}: {found.group()}"
        for file in (*pages, *(ROOT / "labrig").rglob("*.py"))
        for found in re.finditer(r"pip install ['\"]?labrig[^\w`]", file.read_text(encoding="utf-8"))
    ]
    assert offenders == []
