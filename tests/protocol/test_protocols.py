"""The protocols in the checkout, the laws of their models, and conditions on values."""

from contextlib import nullcontext
from math import cos, pi
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from labrig.errors import FileFormatError
from labrig.experiments.camera_calibration.protocol import CameraCalibrationProtocol, GraphPaper
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.experiments.imported_pictures.protocol import ImportProtocol
from labrig.protocol.conditions import Condition
from labrig.protocol.load import load_protocol
from labrig.vision.gel import Gel
from tests.protocol_texts import load_text
from tests.runner.sessions import sweep

PROTOCOLS = Path(__file__).parents[2] / "protocols"
EXAMPLE = Path(__file__).parents[2] / "labrig" / "manual" / "example"
STEERABILITY: Any = load_protocol(PROTOCOLS / "steerability.yaml", PROTOCOL_MODELS)

IMPORT = """
experiment: import
seed: 0
needle: {needle_id: N1, diameter_mm: 1.2}
analysis: {window_start_mm: 4, window_end_mm: 2, min_window_mm: 15, max_radius_sigma_mm: 0.5}
"""


def test_the_steerability_protocol_is_section_v_b_of_the_paper():
    """Eighteen insertions of 40 mm at 1 mm/s into gelatin of 10, 13, 16 and 19 %, bevel not turned; it is frozen."""
    insertion = STEERABILITY.insertion
    assert [specimen.gelatin_percent for specimen in STEERABILITY.specimens] == [10, 13, 16, 19]
    assert STEERABILITY.insertions_per_specimen == 18
    assert (insertion.length_mm, insertion.speed_mm_s, insertion.bevel_roll_rad) == (40, 1, 0)
    with pytest.raises(ValidationError, match="frozen"):
        STEERABILITY.seed = 1


@pytest.mark.parametrize(
    "file", [*PROTOCOLS.glob("*.yaml"), *EXAMPLE.rglob("bevel*")], ids=lambda file: file.name
)
def test_an_example_is_short(file: Path):
    """A protocol states what a lab changes, and an experiment with a needle fits on a page."""
    lines = [line for line in file.read_text(encoding="utf-8").splitlines() if line.strip()]
    stated = [line for line in lines if not line.lstrip().startswith("#")]
    assert len(stated) <= (60 if file.suffix == ".py" else 35)


def test_the_calibration_protocol_shows_the_gel_that_it_could_correct():
    """The example's comment is right YAML at its place, with the names of `labrig calibrate plane`'s options."""
    text = (PROTOCOLS / "calibration.yaml").read_text(encoding="utf-8")
    assert _paper(text).gel is None
    assert _paper(text.replace("# gel:", "gel:")).gel == Gel(index=1.35, depth_mm=10, paper_at="needle")


@pytest.mark.parametrize(
    ("gel", "key"),
    [
        ("{index: 0.9, depth_mm: 10}", "plane.gel.index"),
        ("{index: 2.1, depth_mm: 10}", "plane.gel.index"),
        ("{index: 1.35, depth_mm: -1}", "plane.gel.depth_mm"),
        ("{index: 1.35, depth_mm: 10, index_sigma: 0.7}", "plane.gel.index_sigma"),
        ("{index: 1.35, depth_mm: 10, layers: [{index: 1.5, thickness_mm: -1}]}", "plane.gel.layers.0.thickness_mm"),
        ("{index: 1.35}", "plane.gel.depth_mm"),
        ("{depth_mm: 10}", "plane.gel.index"),
        ("{index: 1.35, depth_mm: 10, paper_at: table}", "plane.gel.paper_at"),
        ("{index: 1.35, depth_mm: 10, layers: [{index: wood, thickness_mm: 3}]}", "plane.gel.layers.0.index"),
    ],
)  # fmt: skip
def test_a_gel_that_cannot_be_is_refused_at_its_key(gel, key):
    """Before a picture is taken: index from 1 to 2, depth from 0, both together, paper at a place that is known."""
    text = (PROTOCOLS / "calibration.yaml").read_text(encoding="utf-8")
    with pytest.raises(FileFormatError) as caught:
        _paper(text.replace("# gel: {index: 1.35, depth_mm: 10, paper_at: needle}", f"gel: {gel}"))
    assert [problem.where.partition(" ")[2] for problem in caught.value.problems] == [key]


def _paper(text: str) -> GraphPaper:
    protocol = load_text(text)
    assert isinstance(protocol, CameraCalibrationProtocol)
    return protocol.plane


def test_an_import_may_know_neither_radius_nor_sheath_nor_scale():
    """The rest is null, not invented; what is known is held to the same rules."""
    protocol = load_text(IMPORT)
    assert isinstance(protocol, ImportProtocol)
    assert protocol.needle.design_radius_mm is protocol.sheath_diameter_mm is protocol.scale is None
    assert protocol.title == "Imported pictures"
    for old, new, key in (
        ("seed: 0", "seed: 0\nsheath_diameter_mm: 1.2", "sheath_diameter_mm"),
        ("diameter_mm: 1.2", "diameter_mm: 1.2, design_radius_mm: 1.2", "needle.design_radius_mm"),
    ):
        with pytest.raises(FileFormatError, match=rf" {key}: .* must be above"):
            load_text(IMPORT.replace(old, new))


@given(st.floats(1.0, 300.0), st.floats(2.0, 1000.0))
def test_the_lateral_reach_never_exceeds_the_length_or_the_diameter_of_the_circle(length_mm, radius_mm):
    """No needle strays further than it is long, nor beyond the far side of its circle."""
    insertion = STEERABILITY.insertion.model_copy(update={"length_mm": length_mm})
    needle = STEERABILITY.needle.model_copy(update={"design_radius_mm": radius_mm})
    reach_mm = STEERABILITY.model_copy(update={"insertion": insertion, "needle": needle}).lateral_reach_mm
    assert reach_mm == pytest.approx(radius_mm * (1 - cos(min(length_mm / radius_mm, pi))))
    assert 0 <= reach_mm <= min(length_mm, 2 * radius_mm)


@given(st.integers(1, 40), st.floats(1.5, 40.0), st.floats(10.0, 400.0))
def test_a_block_is_accepted_exactly_if_its_holes_and_the_last_arc_fit(count, spacing_mm, width_mm):
    """The rule is the geometry, at every size."""
    values = {"insertions_per_specimen": count, "hole_spacing_mm": spacing_mm, "specimen_width_mm": width_mm}
    overrides = [f"{key}={value!r}" for key, value in values.items()]
    fits = (count - 1) * spacing_mm <= width_mm - STEERABILITY.lateral_reach_mm
    with nullcontext() if fits else pytest.raises(FileFormatError, match="sideways"):
        load_protocol(PROTOCOLS / "steerability.yaml", PROTOCOL_MODELS, overrides)


NUMBERS = st.floats(-1e6, 1e6)


@given(NUMBERS, NUMBERS, NUMBERS)
def test_a_condition_means_what_it_says(low: float, high: float, value: float) -> None:
    """It is met below the one limit, and above the other; at a limit it is not."""
    assert Condition(value="x", above=high).holds(value) == (value > high)
    assert Condition(value="x", below=low).holds(value) == (value < low)
    if low <= high:
        assert Condition(value="x", below=low, above=high).holds(value) == (not low <= value <= high)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{value: radius_mm}", "judged by no limit"),
        ("{value: radius_mm, above: .nan}", "finite number"),
        ("{value: radius_mm, below: 30, above: 26}", "below is 30, must be at most above, 26"),
        ("{value: radius_mm, above: 3, do: wait}", "must be 'ask' or 'stop'"),
        ("{value: raduis_mm, above: 3}", "no value is named raduis_mm did you mean radius_mm?"),
        ("{value: max_current_ma, above: 300}", "known here: radius_mm, radius_sd_mm"),
    ],
)
def test_a_condition_that_cannot_be_judged_is_refused(text: str, told: str) -> None:
    """Limits and names are checked when the protocol is loaded; the key is named."""
    with pytest.raises(FileFormatError) as refused:
        sweep(f"conditions=[{{value: radius_mm, above: 90}}, {text}]")
    (problem,) = refused.value.problems
    assert "conditions.1" in problem.where
    assert told in f"{problem.message} {problem.hint}"
