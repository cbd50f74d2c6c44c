"""Design files, and protocols whose needle names one."""

import hashlib
from typing import Any

import pytest

from labrig.errors import FileFormatError
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.protocol.design_file import load_design
from labrig.protocol.load import load_protocol
from labrig.protocol.yaml_file import dump_yaml
from tests.protocol.designs import sweep_with, write_design
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
    path = write_design(tmp_path / "n2.json", **changed)
    with pytest.raises(FileFormatError, match=r"n2\.json:\d+:\d+") as refused:
        load_design(path)
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
