"""Design and specimen files, and protocols whose needle or gels name one."""

import hashlib
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from labrig.errors import FileFormatError, InputError
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.protocol.design_file import load_design
from labrig.protocol.load import load_protocol, load_recorded_protocol
from labrig.protocol.specimen_file import MOST_TRACKS, load_specimen
from labrig.protocol.yaml_file import dump_yaml
from tests.protocol.designs import sweep_with, write_design
from tests.protocol.specimens import make_track, sweep_in, write_specimen
from tests.protocol_texts import load_text

LINE = "  design_file: ../designs/n2.json\n"


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"kind": "labrig-plane"}, "kind"),
        ({"schema_version": 2}, "schema_version is 2"),
        ({"radius_low_mm": 46.0}, "within its tolerance, 46 to 48"),
        ({"tube": {"outer_diameter_mm": 1.4}}, "inner_diameter_mm is missing"),
    ],
)
def test_a_file_that_is_no_design_is_refused_at_its_line(changed, words, tmp_path):
    """Another kind, a newer version, a wrong or missing value: each names the file, its line and the key."""
    with pytest.raises(FileFormatError, match=r"n2\.json:\d+:\d+") as refused:
        load_design(write_design(tmp_path / "n2.json", **changed))
    assert words in refused.value.message


def test_a_needle_takes_its_numbers_from_the_design_that_it_names(tmp_path):
    """Diameter and radius are the design's, and the tolerance and the file's hash stand beside them; also by --set."""
    file = write_design(tmp_path / "designs" / "n2.json")
    path = sweep_with(tmp_path / "protocols", LINE)
    protocol: Any = load_protocol(path, PROTOCOL_MODELS)
    needle = protocol.needle
    assert (needle.needle_id, needle.diameter_mm, needle.design_radius_mm) == ("N1", 1.4, 45.0)
    assert (needle.design.radius_low_mm, needle.design.radius_high_mm) == (42.5, 48.0)
    assert needle.design.file == "../designs/n2.json"
    assert needle.design.sha256 == hashlib.sha256(file.read_bytes()).hexdigest()
    other: Any = load_protocol(path, PROTOCOL_MODELS, [f"needle={{needle_id: N2, {LINE.strip()}}}"])
    assert (other.needle.needle_id, other.needle.design) == ("N2", needle.design)
    file.unlink()
    assert load_text(dump_yaml(protocol)) == protocol, "a record needs the file no more"


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("  diameter_mm: 1.2\n" + LINE, "diameter_mm is 1.2, and design_file ../designs/n2.json says 1.4"),
        (
            "  design_radius_mm: 30\n" + LINE,
            "design_radius_mm is 30, and design_file ../designs/n2.json says",
        ),
        ("  design_file: /etc/design.json\n", "leaves the folder above this file's"),
        ("  design_file: ../../elsewhere.json\n", "leaves the folder above this file's"),
        ("  design_file: ../link.json\n", "leaves the folder above this file's"),
        ("  design_file: nowhere.json\n", "nowhere.json is not a file"),
        ("  design_file: 30\n", "expected the name of a design file"),
        ("  design_file: sweep.yaml\n", "kind is missing"),
        ("  design_file: ../designs/thick.json\n", "must be above needle.diameter_mm, 2.5"),
    ],
)
def test_a_design_that_cannot_be_used_is_refused_at_its_line(lines, words, tmp_path):
    """Numbers beside it, names out of reach, and files that are no design are told with line, key and hint."""
    top = tmp_path / "top"
    write_design(top / "designs" / "n2.json")
    tube = {"outer_diameter_mm": 2.5, "inner_diameter_mm": 0.8, "link_length_mm": 3.5}
    write_design(top / "designs" / "thick.json", tube=tube)
    (top / "link.json").symlink_to(write_design(tmp_path / "elsewhere.json"))
    with pytest.raises(FileFormatError, match=r"sweep\.yaml:\d+:\d+") as refused:
        load_protocol(sweep_with(top / "protocols", lines), PROTOCOL_MODELS)
    assert words in refused.value.message
    assert all(problem.hint for problem in refused.value.problems)


ROOT = Path(__file__).parents[2]


def test_a_gel_has_what_its_specimen_file_says(tmp_path):
    """Name, gelatin and age come from the file beside the protocol, with its SHA-256; a record of it reads the same."""
    file = write_specimen(tmp_path, lines="batch: B7\n")
    protocol = load_protocol(sweep_in(tmp_path, "specimen_file: A1"), PROTOCOL_MODELS)
    (gel,) = protocol.gels.values()
    assert (gel.name, gel.gelatin_percent, gel.block.batch) == ("A1", 10.0, "B7")
    assert gel.block.sha256 == hashlib.sha256(file.read_bytes()).hexdigest()
    assert gel.block.find_age_h(datetime.fromisoformat("2026-11-21T08:30+00:00")) == 24.0
    with_tracks = protocol.put_tracks({"A1": (make_track(4.5),)})
    kept = tmp_path / "recorded.yaml"
    kept.write_text(dump_yaml(with_tracks), encoding="utf-8")
    assert load_recorded_protocol(kept, PROTOCOL_MODELS) == with_tracks


@pytest.mark.parametrize(
    ("gel", "words"),
    [
        ("{specimen_file: A1, gelatin_percent: 13}", "gelatin_percent is 13, and specimen_file A1 says 10"),
        ("{specimen_file: A1, name: A2}", 'name is "A2", and specimen_file A1 says "A1"'),
        ("{specimen_file: A1, block: null}", "block is null, and specimen_file A1 says {"),
        ("specimen_file: A11", "did you mean A1?"),
        ("specimen_file: ../A1", "a specimen's name is also that of its file"),
        ("specimen_file: 7", "specimen_file is 7, expected the name of a specimen"),
        ("{gelatin_percent: 10}", "name is missing"),
    ],
)
def test_a_gel_that_does_not_fit_its_specimen_is_refused_at_its_line(gel, words, tmp_path):
    """Another ratio or name, an unknown specimen and a name that is a path: each with line, column and hint."""
    write_specimen(tmp_path)
    with pytest.raises(FileFormatError, match=r"sweep\.yaml:\d+:\d+ specimens\.0") as refused:
        load_protocol(sweep_in(tmp_path, gel), PROTOCOL_MODELS)
    assert words in f"{refused.value.message} {refused.value.hint}"


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("usable_until: 2026-11-19T09:30+01:00\n", "before cast_on"),
        ("usable_until: 2026-11-20\n", "expected date, time and distance from UTC"),
        ("usable_until: 20261120\n", "usable_until is 20261120, must be a valid string"),
        ("cured: 24\n", "unknown key cured"),
        ("experiment: steerability\n", "this is a protocol, expected a specimen file"),
    ],
)
def test_a_malformed_specimen_file_is_refused_at_its_line(lines, words, tmp_path):
    """Times in the wrong order or without a zone, a spread without its value, and another kind of file."""
    with pytest.raises(FileFormatError, match=r"A1\.yaml:\d+:\d+") as refused:
        load_specimen("A1", [write_specimen(tmp_path, lines=lines).parent])
    assert words in refused.value.message


def test_a_file_under_another_name_or_elsewhere_is_refused(tmp_path):
    """A copied file with the old block's name would keep the tracks of both; a link does not leave the folder."""
    path = write_specimen(tmp_path)
    path.with_name("A3.yaml").symlink_to(write_specimen(tmp_path / "elsewhere", "A3"))
    with pytest.raises(InputError, match=r"A3\.yaml is a link that leaves its folder"):
        load_specimen("A3", [path.parent])
    path.rename(path.with_name("A2.yaml"))
    with pytest.raises(InputError, match=r"A2\.yaml holds the specimen A1"):
        load_specimen("A2", [path.parent])


def test_a_record_can_hold_as_many_tracks_as_are_allowed(tmp_path):
    """A protocol with the most tracks, of runs with the longest names, is small enough to be read again."""
    write_specimen(tmp_path)
    protocol = load_protocol(sweep_in(tmp_path, "specimen_file: A1"), PROTOCOL_MODELS)
    full = protocol.put_tracks({"A1": (make_track(run="r" * 200),) * MOST_TRACKS})
    kept = tmp_path / "recorded.yaml"
    kept.write_text(dump_yaml(full), encoding="utf-8")
    assert load_recorded_protocol(kept, PROTOCOL_MODELS) == full
