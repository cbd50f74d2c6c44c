"""A model written as YAML loads as an equal model."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.imported_pictures.protocol import ImportedNeedle, ImportProtocol
from labrig.protocol.load import load_protocol
from labrig.protocol.model import Model
from labrig.protocol.sections import AnalysisWindow, Scale
from labrig.protocol.yaml_file import dump_yaml, validate_tree
from labrig.protocol.yaml_text import read_tree
from tests.protocol_texts import load_text

PROTOCOLS = Path(__file__).parents[2] / "protocols"

allowed_text = st.text(
    st.characters(exclude_categories=["Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"]), min_size=1, max_size=60
)
names = allowed_text.map(str.strip).filter(bool)
notes = st.lists(allowed_text, max_size=4).map("\n".join)
lengths = st.floats(min_value=5e-324, max_value=1000)


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
    assert load_text(dump_yaml(protocol)) == protocol


def test_defaults_are_written_out():
    """A record does not depend on the defaults of the code that reads it."""
    assert "bevel_roll_rad: 0.0" in dump_yaml(load_protocol(PROTOCOLS / "steerability.yaml", PROTOCOL_MODELS))


@given(
    title=allowed_text, notes=notes, needle_id=names, diameter_mm=st.floats(5e-324, 1),
    radius_mm=st.none() | st.floats(1.5, 1000), sheath_mm=st.none() | st.floats(1.5, 20),
    px_per_mm=st.floats(1e-300, 10_000), origin=st.tuples(st.floats(-1e300, 1e300), st.floats(-1e6, 1e6)),
    window_mm=lengths, seed=st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_any_import_protocol_survives_being_written(
    title, notes, needle_id, diameter_mm, radius_mm, sheath_mm, px_per_mm, origin, window_mm, seed
):  # fmt: skip
    """Floats keep every digit, text every character, null stays null."""
    protocol = ImportProtocol(
        experiment="import",
        title=title,
        notes=notes,
        seed=seed,
        needle=ImportedNeedle(needle_id=needle_id, diameter_mm=diameter_mm, design_radius_mm=radius_mm),
        sheath_diameter_mm=sheath_mm,
        scale=Scale(px_per_mm=px_per_mm, origin_px=origin, insertion="left"),
        analysis=AnalysisWindow(
            window_start_mm=window_mm,
            window_end_mm=0.0,
            min_window_mm=window_mm,
            max_radius_sigma_mm=window_mm,
        ),
    )
    assert load_text(dump_yaml(protocol)) == protocol


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
