"""`labrig export --ro-crate`: a run as an RO-Crate, read back by the library of the format."""

import shutil
from pathlib import Path

import pytest
from rocrate.rocrate import ROCrate

from labrig import __version__
from labrig.errors import InputError
from labrig.record.digest import hash_file
from labrig.report.ro_crate import Author, read_author, read_license
from tests.cli.conftest import ROOT, Labrig
from tests.record.faults import flip_bit

RUN = ROOT / "tests" / "records" / "steerability"
ASKED = (
    "--ro-crate",
    "--license",
    "CC-BY-4.0",
    "--author",
    "A. Person <0000-0002-1825-0097>",
    "--author",
    "B. Person",
)


@pytest.mark.parametrize("private", [(), ("--private",)])
def test_a_crate_describes_every_file_and_how_the_run_was_made(
    private: tuple[str, ...], labrig: Labrig, tmp_path: Path
) -> None:
    """With the SHA-256 of each, licence, people in their order, and the devices; nothing is in it that is not there."""
    done = labrig("export", RUN, *ASKED, *private, "--out", tmp_path / "crate", "--json")
    assert done.exit_code == 0, done.err
    crate = ROCrate(tmp_path / "crate")
    files = {file.id: file for file in crate.get_by_type("File")}
    written = {
        path.relative_to(tmp_path / "crate").as_posix()
        for path in (tmp_path / "crate").rglob("*")
        if path.is_file()
    }
    assert files.keys() == written - {"ro-crate-metadata.json"}
    assert set(done.json()["files"]) == written
    for name, file in files.items():
        path = tmp_path / "crate" / name
        assert (file["sha256"], int(file["contentSize"])) == (hash_file(path), path.stat().st_size)
    root = crate.root_dataset
    assert root["license"].id == "https://spdx.org/licenses/CC-BY-4.0"
    assert [(person["name"], person.id) for person in root["author"]] == [
        ("A. Person", "https://orcid.org/0000-0002-1825-0097"),
        ("B. Person", "#B.-Person"),
    ]
    action = crate.dereference("#run")
    assert action["actionStatus"] == "http://schema.org/CompletedActionStatus"
    names = {device["name"] for device in action["instrument"]}
    drives = {f"drive of the axis {axis}" for axis in ("insertion", "rotation", "linear")}
    assert names == {"labrig", "camera (simulated)", *drives}
    assert "simulated rig" in root["description"]


def test_a_private_crate_holds_no_personal_data(labrig: Labrig, tmp_path: Path) -> None:
    """Tables take the place of the record, which names computer, account and command line."""
    assert labrig("export", RUN, *ASKED, "--private", "--out", tmp_path / "crate").exit_code == 0
    everything = b"".join(path.read_bytes() for path in (tmp_path / "crate").rglob("*") if path.is_file())
    assert b"command_line" in (RUN / "manifest.json").read_bytes()
    assert not any(word in everything for word in (b"command_line", b'"host"', b'"account"'))


def test_the_record_in_a_crate_is_a_sound_run(labrig: Labrig, tmp_path: Path) -> None:
    """It can be opened and checked as it was; a damaged one is refused, and nothing is written."""
    assert labrig("export", RUN, *ASKED, "--out", tmp_path / "crate").exit_code == 0
    assert labrig("runs", "check", tmp_path / "crate" / "record").exit_code == 0
    damaged = Path(shutil.copytree(RUN, tmp_path / "damaged"))
    flip_bit(damaged / "events.jsonl")
    assert labrig("export", damaged, *ASKED, "--out", tmp_path / "again").exit_code == 4
    assert not (tmp_path / "again").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--ro-crate",), "needs a licence"),
        (("--ro-crate", "--license", "CC-BY-4.0"), "needs a licence, and who made it"),
        (("--csv", "--license", "CC-BY-4.0"), "belong to --ro-crate"),
        ((*ASKED, "--csv"), "goes alone"),
        ((*ASKED, "--record"), "goes alone"),
        ((*ASKED, "--author", "C <0000-0002-1825-0098>"), "is no ORCID"),
        (("--ro-crate", "--license", "no licence", "--author", "A"), "is no licence"),
    ],
)
def test_what_makes_no_crate_is_refused(
    options: tuple[str, ...], words: str, labrig: Labrig, tmp_path: Path
) -> None:
    """It exits with 2, and neither licence nor people are invented."""
    done = labrig("export", RUN, *options, "--out", tmp_path / "crate")
    assert (done.exit_code, words in done.err, (tmp_path / "crate").exists()) == (2, True, False), done.err


@pytest.mark.parametrize(
    ("text", "author"),
    [
        ("A. Person", Author("A. Person", None)),
        (" Ö. Person < https://orcid.org/0000-0002-1694-233X > ", Author("Ö. Person", "0000-0002-1694-233X")),
    ],
)
def test_people_are_named_with_or_without_orcid(text: str, author: Author) -> None:
    """By its digits or its address; the last may be an X."""
    assert read_author(text) == author


@pytest.mark.parametrize(
    "text", ["", " ", "<0000-0002-1694-233X>", "A <>", "A <b@example.org>", "A <0000-0002-1694-2330>"]
)
def test_what_names_nobody_is_refused(text: str) -> None:
    """No name, or something else than an ORCID behind it."""
    with pytest.raises(InputError):
        read_author(text)


def test_a_licence_is_an_identifier_or_an_address() -> None:
    """An identifier becomes its address at SPDX."""
    assert read_license("BSD-3-Clause") == "https://spdx.org/licenses/BSD-3-Clause"
    assert read_license("https://example.org/terms") == "https://example.org/terms"


def test_a_comparison_becomes_a_crate(labrig: Labrig, tmp_path: Path) -> None:
    """With every file of its folder, and the runs that were compared; what is private of a run, it does not know."""
    compared = tmp_path / "compared"
    assert labrig("compare", RUN, "--by", "hole", "--out", compared).exit_code == 0
    done = labrig("export", compared, *ASKED, "--out", tmp_path / "crate", "--json")
    assert done.exit_code == 0, done.err
    crate = ROCrate(tmp_path / "crate")
    names = {f"comparison/{path.name}" for path in compared.iterdir()}
    assert {file.id for file in crate.get_by_type("File")} == names
    assert crate.dereference("#comparison")["result"]
    assert RUN.name in crate.root_dataset["description"]
    refused = labrig("export", compared, *ASKED, "--private", "--out", tmp_path / "private")
    assert (refused.exit_code, "comparison" in refused.err) == (2, True)
    (compared / "comparison.json").write_text("[]", encoding="utf-8")
    refused = labrig("export", compared, *ASKED, "--out", tmp_path / "spoilt")
    assert refused.err.startswith(f"error: {compared / 'comparison.json'} cannot be read as a comparison")


def test_a_campaign_becomes_a_crate(labrig: Labrig, tmp_path: Path) -> None:
    """With every part of its table, its page, and the version that computed it; one without a page is refused."""
    made = tmp_path / "made"
    campaign = ("campaign", "protocols/campaign-hinge.yaml", "--set", "repetitions=2", "--out", made)
    assert labrig(*campaign).exit_code == 0
    done = labrig("export", made, *ASKED, "--out", tmp_path / "crate", "--json")
    assert done.exit_code == 0, done.err
    crate = ROCrate(tmp_path / "crate")
    names = {f"campaign/{path.name}" for path in made.iterdir() if not path.name.startswith(".")}
    assert {file.id for file in crate.get_by_type("File")} == names
    assert "campaign/part-000000.parquet" in names
    assert crate.dereference("#labrig")["softwareVersion"] == __version__
    (made / "result.json").unlink()
    refused = labrig("export", made, *ASKED, "--out", tmp_path / "unfinished")
    assert (refused.exit_code, "cannot be read as a finished campaign" in refused.err) == (2, True)
