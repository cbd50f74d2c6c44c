"""What a person reads about a file or a `--set` that is wrong: place, value, what was expected, what to do."""

import re
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from pydantic import Field

from labrig.errors import FileFormatError
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.protocol.load import load_protocol
from labrig.protocol.model import Conflict, Model, Name, Notes, PixelUv
from labrig.protocol.yaml_file import validate_tree, validate_values
from labrig.protocol.yaml_text import read_tree
from tests.protocol_texts import load_text

PROTOCOLS = Path(__file__).parents[2] / "protocols"
STEERABILITY, CALIBRATION = (
    (PROTOCOLS / f"{name}.yaml").read_text(encoding="utf-8") for name in ("steerability", "calibration")
)


def list_problems(text: str) -> list[tuple[str, str, str, str]]:
    """Return line, key, message and hint of each problem of a protocol text."""
    with pytest.raises(FileFormatError) as caught:
        load_text(text)
    places = [problem.where.partition(" ") for problem in caught.value.problems]
    lines = [re.fullmatch(r".*/protocol\.yaml:(\d+):\d+", place) for place, _, _ in places]
    return [
        (line[1] if line else "", key, problem.message, problem.hint)
        for line, (_, _, key), problem in zip(lines, places, caught.value.problems, strict=True)
    ]


def change(old: str, new: str, text: str = STEERABILITY) -> str:
    """Return a text with one part exchanged."""
    assert old in text
    return text.replace(old, new, 1)


# old, new, key, message, hint, and the text of the line that is named if it is not that of the new one
WRONG = [
    ("length_mm: 40", "length_cm: 4", "insertion.length_cm", "unknown key", "did you mean length_mm?"),
    ("name: gel 10 %, gelatin_percent: 10", "specimenfile: A1", "specimens.0.specimenfile", "unknown key", "_file?"),
    ("title:", "pitch: 1\ntitle:", "pitch", "unknown key pitch", "known here: schema_version, experiment"),
    ("title:", "frame_every_mm: 1\ntitle:", "frame_every_mm", "unknown", "insertion.frame_every_mm"),
    ("length_mm: 40", 'length_mm: "40"', "insertion.length_mm", 'is "40", must be a valid number', "[mm]"),
    ("diameter_mm: 1.2", "diameter_mm: 1,2", "needle.diameter_mm", 'is "1,2"', "[mm]"),
    ("diameter_mm: 1.2", "diameter_mm: 1200", "needle.diameter_mm", "is 1200, must be", "[mm]"),
    ("_percent: 10", "_percent: 0.1", "specimens.0.gelatin_percent", "greater than or equal to 1", "[percent]"),
    ("length_mm: 40", "length_mm: .nan", "insertion.length_mm", "is NaN", "[mm]"),
    ("seed: 20260", "seed: true", "seed", "is true", ""),
    ("seed: 20260", "seed: 3.0", "seed", "is 3.0, must be a valid integer", ""),
    ("needle_id: N1", "needle_id: {a: b}", "needle.needle_id", 'is {"a": "b"}', ""),
    ('operator: ""', "operator:", "operator", "is null, must be a valid string", ""),
    ("needle_id: N1", 'needle_id: "N1 "', "needle.needle_id", "neither starts nor ends", ""),
    ("needle_id: N1", 'needle_id: "N\\u202e1"', "needle.needle_id", "U+202E at position 2", ""),
    ("schema_version: 1", "schema_version: 2", "schema_version", "is 2, must be 1", "newer labrig"),
    (": steerability\n", ": sterability\n", "experiment", "must be one of", "mean steerability?"),
    (": steerability\n", ": 7\n", "experiment", "is 7, must be one of", "known here: camera-calibration"),
    # lists are told as a whole or by their entry, choices with the one that was probably meant
    ("[150, 310]", "[320]", "plane.origin_px", "is [320], must be a list of 2", "[px]"),
    ("[150, 310]", "[320, 200, 1]", "plane.origin_px", "should have at most 2", "[px]"),
    ("[150, 310]", "320", "plane.origin_px", "is 320, must be a valid array", "[px]"),
    ("[150, 310]", "[320, left]", "plane.origin_px.1", 'origin_px.1 is "left", must be a valid number', ""),
    ("insertion: right", "insertion: Rihgt", "plane.insertion", "must be 'right', 'left', ", "mean right?"),
    # values that do not go together
    ("spacing_mm: 10", "spacing_mm: 14", "hole_spacing_mm", "is at 238 mm, must be at most 217.1", ""),
    ("spacing_mm: 10", "spacing_mm: 1.2", "hole_spacing_mm", "must be above needle.diameter_mm, 1.2", ""),
    ("width_mm: 240", "width_mm: 20", "specimen_width_mm", "strays 22.9 mm sideways", ""),
    ("radius_mm: 30", "radius_mm: 1", "needle.design_radius_mm", "must be above diameter_mm, 1.2", ""),
    ("diameter_mm: 2.0", "diameter_mm: 1.1", "sheath.diameter_mm", "must be above needle.diameter_mm, 1.2", ""),
    ("length_mm: 40", "length_mm: 20", "analysis.min_window_mm", "asks for 21 mm of needle", "", "min_window_mm:"),
    ("gel 13 %", "gel 10 %", "specimens.1.name", 'name "gel 10 %" is taken by specimens.0', "", "gel 13 %"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "key", "message", "hint", "line"), [(*row, "")[:6] for row in WRONG])
def test_a_wrong_value_is_told_with_place_value_limit_and_hint(old, new, key, message, hint, line):
    """One fault gives one problem at its line, in words that say what to write instead."""
    base = STEERABILITY if old in STEERABILITY else CALIBRATION
    text = change(old, new, base)
    ((told_line, told_key, told_message, told_hint),) = list_problems(text)
    looked_in, part = (base, line) if line else (text, new.splitlines()[0])
    first = next(number for number, each in enumerate(looked_in.splitlines(), start=1) if part in each)
    assert (told_line, told_key) == (str(first), key)
    assert message in told_message
    assert hint in told_hint


def test_all_problems_of_a_file_are_told_in_its_order():
    """A file is corrected in one go: nothing is told only after something else is right, and rules hide no other."""
    text = change("seed: 20260", "seed: x\nseed: 3")
    text = change("  depth_mm: 15\n", "", change("diameter_mm: 1.2", "diametr_mm: 1.2", text))
    told = [key for _, key, _, _ in list_problems(text)]
    assert told == ["seed", "seed", "needle.diametr_mm", "sheath.depth_mm"]
    text = change("diameter_mm: 2.0", "diameter_mm: 1.0", change("hole_spacing_mm: 10", "hole_spacing_mm: 1"))
    assert [key for _, key, _, _ in list_problems(text)] == ["hole_spacing_mm", "sheath.diameter_mm"]


def test_what_is_missing_is_told_with_what_it_holds():
    """A section with its description; `experiment:`, which chooses the model, with the choices."""
    ((_, _, message, hint),) = list_problems(re.sub(r"sheath:\n(  .*\n)+", "", STEERABILITY))
    assert (message, hint) == ("sheath is missing", "The tube that brings the needle into the gel.")
    ((_, _, message, hint),) = list_problems(change("experiment: steerability\n", ""))
    assert (message[:44], hint[-13:]) == ("experiment is missing, must be one of camera", "steerability`")
    assert "gel. Its keys: d" in list_problems(change("sheath:\n", "sheath: 2\nother:\n"))[0][3]


def test_a_file_with_hundreds_of_faults_tells_the_first_fifty():
    """Nobody reads more; the count of the rest is told."""
    with pytest.raises(FileFormatError) as caught:
        load_text(STEERABILITY + "".join(f"key{i}: 1\n" for i in range(200)))
    assert len(caught.value.problems) == 51
    assert caught.value.problems[-1].message == "and 150 more problems like these"


class Fast(Model):
    """A camera of one kind."""

    kind: Literal["fast"]
    """Which camera."""
    rate_hz: float = Field(gt=0, le=1000)
    """Frames in a second [Hz]."""


class Slow(Model):
    """A camera of another kind."""

    kind: Literal["slow"]
    """Which camera."""
    exposure_s: float = Field(gt=0, le=10)
    """Exposure [s]."""


class BenchModel(Model):
    """A file as another room would describe it: kinds, maps, switches."""

    camera: Annotated[Fast | Slow, Field(discriminator="kind")]
    """The camera."""
    nodes: dict[str, int] = Field(default_factory=dict)
    """CAN node of each axis."""
    light: bool = True
    """Whether the light is on."""
    gain: float | Literal["auto"] = "auto"
    """Gain [dB], or auto."""
    origin_px: PixelUv = (0.0, 0.0)
    name: Name = "bench"
    notes: Notes = ""

    def conflicts(self) -> list[Conflict]:
        """Yield a node that stands twice."""
        twice = len(set(self.nodes.values())) < len(self.nodes)
        return [Conflict("nodes", "two axes have one node")] if twice else []


SLOW = "camera: {kind: slow, exposure_s: 1}\n"
BENCHES = [
    ("camera: {kind: fsat, rate_hz: 3}", "1:10 camera.kind", 'kind is "fsat"', "did you mean fast?"),
    ("camera: {rate_hz: 3}", "1:1 camera.kind", "kind is missing, must be one of fast, slow", "kind: fast"),
    ("camera: {kind: fast, rate: 3}", "1:22 camera.rate", "unknown key rate", "did you mean rate_hz?"),
    ("camera: {kind: slow, exposure_s: 20}", "1:22 camera.exposure_s", "is 20", "Exposure [s]."),
    (f"{SLOW}light: yes", "2:1 light", 'is "yes", must be a valid boolean', ""),
    (f"{SLOW}gain: high", "2:1 gain", "must be a valid number or 'auto'", "Gain [dB]"),
    (f"{SLOW}nodes: {{x: one}}", "2:9 nodes.x", 'x is "one"', ""),
    (f"{SLOW}nodes: {{x: 1, y: 1}}", "2:1 nodes", "two axes have one node", ""),
    ("camera: 3", "1:1 camera", "camera is 3", ""),
]


@pytest.mark.parametrize(("text", "where", "message", "hint"), BENCHES)
def test_models_of_other_rooms_are_explained_as_well(text, where, message, hint):
    """Sections of several kinds, maps, switches and unions are told in the same words."""
    with pytest.raises(FileFormatError) as caught:
        validate_tree(read_tree(text, "rig.yaml"), BenchModel)
    (problem,) = caught.value.problems
    assert problem.where == f"rig.yaml:{where}"
    assert message in problem.message
    assert hint in problem.hint


def test_values_that_stand_in_no_file_are_told_by_their_source():
    """Options of a command make a model through the same checks.

    User-written text is kept as written: notes may have lines, any script joins its letters.
    """
    camera = {"kind": "fast", "rate_hz": 1}
    values = {"camera": camera, "origin_px": (1, 2), "notes": "a\n\tb", "name": "می‌خواهم 👩‍🔬 é"}
    made = validate_values(values, "labrig import", BenchModel)
    assert (made.origin_px, made.notes, made.name) == ((1.0, 2.0), values["notes"], values["name"])
    with pytest.raises(FileFormatError) as caught:
        validate_values({"camera": {**camera, "rate_hz": -1}}, "labrig import", BenchModel)
    assert [problem.where for problem in caught.value.problems] == ["labrig import camera.rate_hz"]


SWEEP = Path(__file__).parents[2] / "protocols" / "steerability.yaml"


def steerability(*overrides: str, seed: int | None = None) -> Any:
    """Return the protocol of the checkout with overrides."""
    return load_protocol(SWEEP, PROTOCOL_MODELS, overrides, seed)


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
        ("specimens=[{name: A, gelatin_percent: 0}]", "--set specimens.0.gelatin_percent", "greater", "[per"),
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
    text = SWEEP.read_text(encoding="utf-8").replace("hole_spacing_mm: 10", "hole_spacing_mm: ten")
    path.write_text(text)
    line = text[: text.index("hole_spacing_mm: ten")].count("\n") + 1
    with pytest.raises(FileFormatError) as caught:
        load_protocol(path, PROTOCOL_MODELS, ["operator=1"], -1)
    places = [problem.where.split(" ")[0] for problem in caught.value.problems]
    assert places == [f"{path}:{line}:1", "--set", "--seed"]
