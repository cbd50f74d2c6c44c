"""A model written as YAML loads as an equal model."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.protocol.load import load_protocol
from labrig.protocol.model import Model
from labrig.protocol.yaml_file import dump_yaml, validate_tree
from labrig.protocol.yaml_text import read_tree
from tests.protocol_texts import load_text

PROTOCOLS = Path(__file__).parents[2] / "protocols"


class Mixed(Model):
    """Values of every kind that a file can hold."""

    text: str
    number: float
    count: int
    switch: bool
    maybe: float | None
    many: tuple[str, ...]
    table: dict[str, float]


@pytest.mark.parametrize("name", ["steerability.yaml", "calibration.yaml"])
def test_the_protocols_in_the_checkout_survive_being_written(name: str):
    """What the record keeps of a protocol means the same as the file it came from."""
    protocol = load_protocol(PROTOCOLS / name, PROTOCOL_MODELS)
    written = dump_yaml(protocol)
    assert load_text(written) == protocol
    if name == "steerability.yaml":
        assert "bevel_roll_rad: 0.0" in written, "a record does not depend on the defaults of its reader"


any_text = st.text(st.characters(exclude_categories=["Cs"]), max_size=40)


@given(
    st.builds(
        Mixed,
        text=any_text,
        number=st.floats(allow_nan=False, allow_infinity=False),
        count=st.integers(-(10**17), 10**17),
        switch=st.booleans(),
        maybe=st.none() | st.floats(allow_nan=False, allow_infinity=False),
        many=st.lists(any_text, max_size=3).map(tuple),
        table=st.dictionaries(any_text, st.floats(allow_nan=False, allow_infinity=False), max_size=3),
    )
)
def test_any_model_survives_being_written(model: Mixed):
    """Text that looks like a number, a date, a tag or a comment comes back as text, keys included."""
    assert validate_tree(read_tree(dump_yaml(model), "written"), Mixed) == model
