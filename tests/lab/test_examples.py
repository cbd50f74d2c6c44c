"""What a new lab folder starts with."""

from pathlib import Path

from labrig.lab.examples import find_examples, read_examples

ROOT = Path(__file__).parents[2]
PATTERNS = ("protocols/*.yaml", "calibration/rig-*.yaml", "*/*.schema.json", "data/*/*.schema.json")


def test_every_example_of_the_checkout_is_in_the_package() -> None:
    """A new protocol, rig file or schema must be named in pyproject.toml, so that a wheel holds it."""
    expected = {path.relative_to(ROOT).as_posix() for pattern in PATTERNS for path in ROOT.glob(pattern)}
    assert expected <= find_examples().keys()


def test_an_example_is_the_file_of_the_checkout() -> None:
    """Its place in a lab folder is that in the checkout."""
    for place, content in read_examples().items():
        assert content == (ROOT / place).read_bytes(), place
