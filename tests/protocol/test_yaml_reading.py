"""YAML text -> values, by the core schema of YAML 1.2, bounded, and back; anything else is a FileFormatError."""

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.errors import FileFormatError, Problem
from labrig.experiments.declared import PROTOCOL_MODELS
from labrig.protocol.load import load_protocol
from labrig.protocol.model import Model
from labrig.protocol.yaml_file import dump_yaml, load_yaml_model, validate_tree
from labrig.protocol.yaml_text import MAX_DEPTH, MAX_VALUES, read_tree
from tests.protocol_texts import load_text

PROTOCOLS = Path(__file__).parents[2] / "protocols"


class Anything(Model):
    """A model that takes one text, number or list."""

    a: str | float | bool | list[float] | None = None


def value_of(text: str) -> object:
    """Return what a text after a key is read as."""
    return read_tree(f"a: {text}\n", "x.yaml").section(())["a"]


def only_problem(text: str):
    """Return the one problem of a text."""
    with pytest.raises(FileFormatError) as caught:
        read_tree(text, "x.yaml")
    (problem,) = caught.value.problems
    return problem


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("40", 40), ("-0.5", -0.5), ("1e3", 1000.0), (".5", 0.5), ("010", 10), ("0o17", 15), ("0x1F", 31),
        ("123456789012345678901234567890", 123456789012345678901234567890), ("1_000", 1000),
        ("true", True), ("False", False), ("", None), ("~", None),
        ("no", "no"), ("12:30", "12:30"), ("2026-11-20", "2026-11-20"), ("'40'", "40"), ('"true"', "true"),
        ("| \n  two\n  lines\n", "two\nlines\n"), ("[1, {b: c}]", [1, {"b": "c"}]),
    ],
)  # fmt: skip
def test_scalars_are_those_of_yaml_1_2(text, value):
    """A scalar means what YAML 1.2 says, nothing that YAML 1.1 adds: `no` is a word, and a date is a text."""
    found = value_of(text)
    assert found == value
    assert type(found) is type(value)


def test_what_the_model_refuses_by_name_is_read():
    """.inf and .nan are numbers to the reader; an alias is the value that its anchor names."""
    nan = value_of(".NaN")
    assert isinstance(nan, float)
    assert (value_of("-.inf"), math.isnan(nan)) == (-math.inf, True)
    assert read_tree("a: &x [1, 2]\nb: *x\n", "x.yaml").values == {"a": [1, 2], "b": [1, 2]}


@pytest.mark.parametrize(
    ("text", "where", "message"),
    [
        ("", "x.yaml", "empty"),
        ("# nothing but a comment\n", "x.yaml", "empty"),
        ("- 1\n- 2\n", "x.yaml:1:1", "[1, 2]"),
        ("seed:7\n", "x.yaml:1:1", '"seed:7"'),
        ("a: 1\n---\nb: 2\n", "x.yaml:1:1", "single document"),
        ("a: 1\n\tb: 2\n", "x.yaml:2:1", "cannot start"),
        ("a: 'open\nb: 2\n", "x.yaml:1:4", "unexpected end"),
        ("a: [1, 2\nb: 3\n", "x.yaml:1:4", "expected ',' or ']'"),
        ("a: b: c\n", "x.yaml:1:5", "mapping values"),
        ("a: @home\n", "x.yaml:1:4", "cannot start"),
        ('a: "\\UFFFFFFFF"\n', "x.yaml", "not YAML"),
        ("a: 1\nb: x\x07y\n", "x.yaml:2:5", "special characters"),
        ("a: *b\n", "x.yaml:1:4", "undefined alias"),
        ("a: &a [*a]\n", "x.yaml:1:4", "deeper than"),
        (f"a: {'[' * 5000}", f"x.yaml:1:{4 + MAX_DEPTH}", "maximum depth"),
        ("? " * 5000, f"x.yaml:1:{1 + 2 * (MAX_DEPTH + 1)}", "maximum depth"),
    ],
)
def test_what_is_no_yaml_is_told_with_line_and_column(text, where, message):
    """A text that cannot be read gives one problem at the line and column where it goes wrong."""
    problem = only_problem(text)
    assert problem.where == where
    assert message in problem.message


def test_an_anchor_bomb_is_refused_before_it_expands():
    """Aliases are counted, not expanded: a short file cannot fill the memory, nor nest deeper than text can."""
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 12)]
    assert f"more than {MAX_VALUES}" in only_problem("\n".join(lines)).message
    chain = ["a0: &a0 [x]", *(f"a{i}: &a{i} [*a{i - 1}]" for i in range(1, 2000))]
    assert f"deeper than {MAX_DEPTH}" in only_problem("\n".join(chain)).message


def test_duplicate_keys_tags_and_keys_that_are_no_words_are_gathered():
    """Faults that do not stop the reading are told together, in the order of the file."""
    with pytest.raises(FileFormatError) as caught:
        validate_tree(read_tree("a: 1\na: !!python/object:os.system 2\n? [c]\n: 4\n", "x.yaml"), Anything)
    assert [(problem.where, problem.message.split(",")[0]) for problem in caught.value.problems] == [
        ("x.yaml:2:1 a", "the key is given twice"),
        ("x.yaml:2:4 a", "the tag python/object:os.system is not allowed"),
        ("x.yaml:3:3", "a key must be a plain word"),
    ]


@given(st.text(alphabet="ab:-?[]{}&*!|>'\"%@#,\\ \n\t0.~<\x00\x85\ud800é", max_size=60))
def test_any_text_is_read_or_refused(text):
    """Whatever stands in a file gives a model or a FileFormatError with a place and a sentence."""
    problems: tuple[Problem, ...] = ()
    try:
        validate_tree(read_tree(text, "x.yaml"), Anything)
    except FileFormatError as error:
        problems = error.problems
    assert all(problem.where.startswith("x.yaml") and problem.message for problem in problems)


@pytest.mark.parametrize(
    ("name", "message", "hint"),
    [
        ("sterability.yaml", "there is no such file", "did you mean steerability.yaml?"),
        ("no/x.yaml", "there is no such file", "there is no folder"),
        (".", "cannot be read: Is a directory", "steerability.yaml"),
        ("bytes.yaml", "not YAML in UTF-8: invalid start byte", "save the file as UTF-8"),
        ("large.yaml", "larger than 256 kB", "is this the right file?"),
        ("a\0b", "cannot be read", ""),
    ],
)
def test_a_file_that_cannot_be_read_is_told_with_a_hint(name, message, hint, tmp_path):
    """A wrong name, a folder, other bytes, a recording given by mistake: a sentence, and what was probably meant."""
    (tmp_path / "steerability.yaml").write_text("a: 1\n")
    (tmp_path / "marked.yaml").write_bytes(b"\xef\xbb\xbfa: 1\n")
    (tmp_path / "bytes.yaml").write_bytes(b"\xef\xbb\xbfa: 1\n# \xc3\xa9 \xff\n")
    (tmp_path / "large.yaml").write_bytes(b"a: 1\n" * 100_000)
    with pytest.raises(FileFormatError) as caught:
        load_yaml_model(tmp_path / name, Anything)
    (problem,) = caught.value.problems
    assert message in problem.message
    assert hint in problem.hint
    if name == "bytes.yaml":  # the column counts characters, behind the byte order mark
        assert problem.where == f"{tmp_path / name}:2:5"
    assert load_yaml_model(tmp_path / "marked.yaml", Anything).a == 1


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
