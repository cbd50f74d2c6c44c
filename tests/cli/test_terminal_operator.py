"""Questions to the operator, at a real pseudo-terminal."""

import io
import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TextIO

import pytest

from labrig.cli.signals import SignalNote
from labrig.cli.terminal_operator import TerminalOperator
from labrig.devices.operator import OperatorRequest, PickTarget, PlaceSpecimen, ReadScale
from labrig.errors import InterruptedRunError, SafetyStopError

REQUEST = PlaceSpecimen("gel 10 %", 10)


@dataclass(frozen=True)
class Terminal:
    """Both ends of a pseudo-terminal: labrig's and the operator's."""

    stream: TextIO
    keyboard: int

    def type(self, text: str) -> None:
        """Write input for the next question."""
        os.write(self.keyboard, text.encode())


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    """Open a pseudo-terminal."""
    keyboard, screen = os.openpty()
    with os.fdopen(screen, "r", encoding="utf-8") as stream:
        yield Terminal(stream, keyboard)
    os.close(keyboard)


@pytest.mark.parametrize(
    ("typed", "confirmed"), [("yes\n", True), ("Y\n", True), ("no\n", False), ("n\n", False)]
)
def test_yes_and_no_are_taken(typed: str, confirmed: bool, terminal: Terminal) -> None:
    """Yes and no are accepted in their long and short forms."""
    terminal.type(typed)
    assert TerminalOperator(SignalNote(), terminal.stream).ask(REQUEST, lambda: None).confirmed is confirmed


def test_anything_else_is_asked_again(terminal: Terminal, capsys: pytest.CaptureFixture[str]) -> None:
    """A mistyped or empty answer repeats the question."""
    terminal.type("maybe\n\nyes\n")
    assert TerminalOperator(SignalNote(), terminal.stream).ask(REQUEST, lambda: None).confirmed
    assert capsys.readouterr().err.count("gel 10 %") == 3


def test_a_pixel_is_two_numbers(terminal: Terminal, capsys: pytest.CaptureFixture[str]) -> None:
    """Two finite numbers are a pixel; one number, words and infinity repeat the question."""
    terminal.type("1020\nthere\ninf 3\n1020 290.5\n")
    answer = TerminalOperator(SignalNote(), terminal.stream).ask(PickTarget("000003.png"), lambda: None)
    assert (answer.confirmed, answer.pixel) == (True, (1020.0, 290.5))
    assert capsys.readouterr().err.count("000003.png") == 4


@pytest.mark.parametrize(
    ("request_", "typed", "wanted"),
    [
        (ReadScale("linear", "mm", "Read it."), "yes", "a number such as 12.5"),
        (ReadScale("linear", "mm", "Read it."), "1 2", "a number such as 12.5"),
        (PickTarget("000003.png"), "yes", "two numbers such as 640 290.5"),
        (REQUEST, "12", "yes, or no to stop"),
    ],
)
def test_an_answer_of_another_kind_is_told_what_is_wanted(
    request_: OperatorRequest, typed: str, wanted: str, terminal: Terminal, capsys: pytest.CaptureFixture[str]
) -> None:
    """A yes in answer to a number repeats the question with the expected form."""
    terminal.type(f"{typed}\nno\n")
    assert not TerminalOperator(SignalNote(), terminal.stream).ask(request_, lambda: None).confirmed
    assert f"'{typed}' is not understood: {wanted}" in capsys.readouterr().err


def test_a_scale_is_read_with_a_point_or_a_comma(terminal: Terminal) -> None:
    """A reading may have a decimal point or comma, and a sign."""
    terminal.type("-12,5\n")
    answer = TerminalOperator(SignalNote(), terminal.stream).ask(ReadScale("linear", "mm", ""), lambda: None)
    assert (answer.confirmed, answer.reading) == (True, -12.5)


def test_a_signal_ends_the_question(terminal: Terminal) -> None:
    """A signal during a question interrupts the run."""
    note = SignalNote()
    note.take(15, None)
    with pytest.raises(InterruptedRunError, match="SIGTERM"):
        TerminalOperator(note, terminal.stream).ask(REQUEST, lambda: None)


def test_a_pipe_cannot_confirm() -> None:
    """Input from a pipe is not accepted as a confirmation."""
    with pytest.raises(SafetyStopError, match="nobody is there"):
        TerminalOperator(SignalNote(), io.StringIO("yes\n")).ask(REQUEST, lambda: None)
