"""`--set dotted.key=value` puts single values over a file, with the same errors."""

from pathlib import Path
from typing import Any

import pytest

from labrig.errors import FileFormatError
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.protocol.load import load_protocol

STEERABILITY = Path(__file__).parents[2] / "protocols" / "steerability.yaml"


def steerability(*overrides: str, seed: int | None = None) -> Any:
    """Return the protocol of the checkout with overrides."""
    return load_protocol(STEERABILITY, PROTOCOL_MODELS, overrides, seed)


def test_an_override_replaces_one_value_and_leaves_the_rest():
    """By dotted key or index; from left to right, and --seed last; what is not quoted is text as the shell gave it."""
    protocol = steerability("insertion.length_mm=30", "specimens.1.name=gel B", "seed=1", "seed=2")
    assert (protocol.insertion.length_mm, protocol.insertion.speed_mm_s, protocol.seed) == (30, 1, 2)
    assert [specimen.name for specimen in protocol.specimens][:2] == ["gel 10 %", "gel B"]
    assert steerability("seed=1", "seed=2", seed=3).seed == 3
    assert steerability("notes=gel: old # batch = 3").notes == "gel: old # batch = 3"
    protocol = steerability('needle.needle_id="12"', "specimens=[{name: A, gelatin_percent: 12}]")
    assert protocol.needle.needle_id == "12"
    assert [(specimen.name, specimen.gelatin_percent) for specimen in protocol.specimens] == [("A", 12.0)]


@pytest.mark.parametrize(
    ("override", "where", "message", "hint"),
    [
        ("insertion.lenght_mm=3", "--set insertion.lenght_mm", "unknown key", "did you mean length_mm?"),
        ("nedle.diameter_mm=1", "--set nedle", "unknown key nedle", "did you mean needle?"),
        ("insertion.length_mm=4 cm", "--set insertion.length_mm", 'is "4 cm"', "[mm]"),
        ("specimens.4.name=x", "--set specimens.4.name", "expected 0 to 3", ""),
        ("specimens.last.name=x", "--set specimens.last.name", "names no entry", ""),
        ("seed.x=1", "--set seed.x", "cannot be set inside 20260", ""),
        ("seed", "--set", '"seed" is not an override, expected dotted.key=value', "for example"),
        ("=3", "--set", "is not an override", "for example"),
        ("a..b=3", "--set", "is not an override", "for example"),
        ("a." * 5000 + "b=1", "--set", "is not an override", "for example"),
        ("specimens=[{name: A", "--set specimens", "not YAML", ""),
        ("specimens=[!x {}]", "--set specimens", "the tag !x is not allowed", ""),
    ],
)
def test_a_wrong_override_is_told_like_a_wrong_file(override: str, where: str, message: str, hint: str):
    """The place is the option and its key."""
    with pytest.raises(FileFormatError) as caught:
        steerability(override)
    (problem,) = caught.value.problems
    assert problem.where == where
    assert message in problem.message
    assert hint in problem.hint


def test_problems_of_file_overrides_and_seed_are_told_at_once(tmp_path: Path):
    """Those of the file come first, at its lines; the others at their options."""
    path = tmp_path / "p.yaml"
    text = STEERABILITY.read_text(encoding="utf-8").replace("hole_spacing_mm: 10", "hole_spacing_mm: ten")
    path.write_text(text)
    line = text[: text.index("hole_spacing_mm: ten")].count("\n") + 1
    with pytest.raises(FileFormatError) as caught:
        load_protocol(path, PROTOCOL_MODELS, ["operator=1"], -1)
    places = [problem.where.split(" ")[0] for problem in caught.value.problems]
    assert places == [f"{path}:{line}:1", "--set", "--seed"]
