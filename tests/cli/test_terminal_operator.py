"""Questions to the operator, at a real pseudo-terminal."""

import io
import os
import re
import signal
import subprocess
import sys
import termios
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import redirect_stderr
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO
from urllib.error import HTTPError
from urllib.request import urlopen

import cv2
import numpy as np
import pytest

from labrig.cli.pixel_page import PixelPage
from labrig.cli.signals import SignalNote
from labrig.cli.terminal_operator import TerminalOperator
from labrig.devices.operator import (
    NO_OFFER,
    Answer,
    Choice,
    Offer,
    OperatorRequest,
    Paused,
    PickTarget,
    PlaceSpecimen,
    ReadLength,
)
from labrig.errors import InterruptedRunError, SafetyStopError

REQUEST = PlaceSpecimen("gel 10 %", 10)
PICK, SCALE = PickTarget("3.png"), ReadLength()


@dataclass(frozen=True)
class Terminal:
    """Both ends of a pseudo-terminal: labrig's and the operator's."""

    stream: TextIO
    keyboard: int

    def type(self, text: str) -> None:
        """Type now."""
        os.write(self.keyboard, text.encode())

    def ask(self, request: OperatorRequest, *typed: str, offer: Offer = NO_OFFER) -> Answer:
        """Ask a person who types a line whenever labrig waits for one."""
        lines = iter(typed)
        return TerminalOperator(SignalNote(), self.stream).ask(request, lambda: self.type(next(lines)), offer)


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    """Open a pseudo-terminal."""
    keyboard, screen = os.openpty()
    with os.fdopen(screen, "r", encoding="utf-8") as stream:
        yield Terminal(stream, keyboard)
    os.close(keyboard)


OFFERED = Offer(tuple(Choice), "hole 3 of 18, gel 2 of 4, about 52 minutes of yours and 34 of the rig's left")
NO = Answer(confirmed=False, note="no")


def chose(choice: Choice, note: str = "") -> Answer:
    """Return the answer of a person who chose something instead."""
    return Answer(confirmed=False, note=note, choice=choice)


@pytest.mark.parametrize(
    ("request_", "typed", "answer", "told"),
    [
        (REQUEST, "yes", Answer(confirmed=True, note="yes"), ""),
        (REQUEST, "maybe||Y", Answer(confirmed=True, note="y"), ""),
        (REQUEST, "s|n", Answer(confirmed=False, note="n"), ""),
        (PICK, "1020|there|inf 3|10 2.5", Answer(confirmed=True, note="10 2.5", pixel=(10.0, 2.5)), ""),
        (SCALE, "-12.5", Answer(confirmed=True, note="-12.5", reading=-12.5), ""),
        (SCALE, "-12,5", Answer(confirmed=True, note="-12,5", reading=-12.5), ""),
        (Paused("after this insertion"), "c", Answer(confirmed=True, note="c"), ""),
        (Paused("after this insertion"), "no", NO, ""),
        (SCALE, "yes|no", NO, "'yes' is not understood: a number such as 12.5"),
        (SCALE, "1 2|no", NO, "'1 2' is not understood: a number such as 12.5"),
        (PICK, "yes|no", NO, "'yes' is not understood: two numbers such as 640 290.5"),
        (REQUEST, "12|no", NO, "'12' is not understood: yes, or no to stop"),
    ],
)
def test_an_answer_is_what_its_question_wants(
    request_: OperatorRequest, typed: str, answer: Answer, told: str, terminal: Terminal,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """Short and long forms are taken; whatever else is typed, an empty line too, repeats the question with its form."""
    lines = typed.split("|")
    assert terminal.ask(request_, *(f"{line}\n" for line in lines)) == answer
    shown = capsys.readouterr().err
    assert (shown.count(request_.text), told in shown) == (len(lines), True)


@pytest.mark.parametrize(
    ("typed", "answer"),
    [
        ("R", chose(Choice.REPEAT)),
        ("s", chose(Choice.SKIP)),
        ("u", chose(Choice.UNDO)),
        ("b the picture is blurred", chose(Choice.MARK_BAD, "the picture is blurred")),
        ("t|Bubbles at 3 mm", chose(Choice.NOTE, "Bubbles at 3 mm")),
        ("t||t x", chose(Choice.NOTE, "x")),
        ("t a\x1b[2Jb\x07\u202ec", chose(Choice.NOTE, "a[2Jbc")),
    ],
)
def test_each_choice_has_a_key(
    typed: str, answer: Answer, terminal: Terminal, capsys: pytest.CaptureFixture[str]
) -> None:
    """A letter chooses; a note and a reason are typed behind it or when asked for, without control characters."""
    assert terminal.ask(REQUEST, *(f"{line}\n" for line in typed.split("|")), offer=OFFERED) == answer
    assert f"{OFFERED.status}\n>> " in capsys.readouterr().err


def test_without_a_person_nothing_is_confirmed(terminal: Terminal) -> None:
    """A signal interrupts the run; input from a pipe is no answer, and Ctrl+D on an empty line is none."""
    note = SignalNote()
    note.take(15, None)
    with pytest.raises(InterruptedRunError, match="SIGTERM"):
        TerminalOperator(note, terminal.stream).ask(REQUEST, lambda: None)
    with pytest.raises(SafetyStopError, match="nobody is there"):
        TerminalOperator(SignalNote(), io.StringIO("yes\n")).ask(REQUEST, lambda: None)
    with pytest.raises(SafetyStopError, match="standard input ended"):
        terminal.ask(REQUEST, "\x04")


@pytest.mark.parametrize("early", ["yes\n", "yes", "yes\nyes\nyes\n"])
def test_an_answer_typed_before_the_question_does_not_count(early: str, terminal: Terminal) -> None:
    """A yes typed while an axis moved confirms nothing, and does not stand before the answer; each question is new."""
    terminal.type(early)
    assert not terminal.ask(REQUEST, "no\n").confirmed
    assert terminal.ask(REQUEST, "maybe\nyes\nyes\n", "yes\n").note == "yes"
    assert not terminal.ask(REQUEST, "no\n").confirmed


def test_a_line_typed_in_pieces_is_one_answer(terminal: Terminal) -> None:
    """What Ctrl+D sends without a line end, or a terminal in raw mode by the key, waits for the return key."""
    assert not terminal.ask(REQUEST, "n\x04", "o\x04", "\n").confirmed
    settings = termios.tcgetattr(terminal.stream)
    settings[0] &= ~termios.ICRNL
    settings[3] &= ~termios.ICANON
    termios.tcsetattr(terminal.stream, termios.TCSANOW, settings)
    assert terminal.ask(REQUEST, "y", "e", "s\r").confirmed


class Stubborn(io.TextIOWrapper):
    """A terminal that says that it is one even once it has closed."""

    def __init__(self, stream: TextIO) -> None:
        super().__init__(stream.buffer, encoding="utf-8")

    def isatty(self) -> bool:
        """Return true."""
        return True


@pytest.mark.parametrize("closes", ["before the question", "during the question"])
def test_a_terminal_that_closes_stops_the_axes(closes: str) -> None:
    """The window is closed: nobody can answer, and the rig is told so."""
    keyboard, screen = os.openpty()
    with os.fdopen(screen, "r", encoding="utf-8") as stream:
        terminal = Stubborn(stream)
        if closes == "before the question":
            os.close(keyboard)
        with pytest.raises(SafetyStopError, match=r"terminal closed|standard input ended"):
            TerminalOperator(SignalNote(), terminal).ask(REQUEST, lambda: os.close(keyboard))


_IN_THE_BACKGROUND = """
import os, pty, sys
from labrig.cli.signals import SignalNote
from labrig.cli.terminal_operator import TerminalOperator
from labrig.devices.operator import ClearBench
from labrig.errors import SafetyStopError
result, say = os.pipe()
session, keyboard = pty.fork()
if session == 0:
    if os.fork() == 0:
        os.setpgid(0, 0)
        try:
            TerminalOperator(SignalNote(), sys.stdin).ask(ClearBench("it"), lambda: None)
        except SafetyStopError as error:
            os.write(say, error.message.encode())
    else:
        os.wait()
    os._exit(0)
os.write(keyboard, b"yes\\nyes\\n")
print(os.read(result, 200).decode())
"""


def test_a_labrig_in_the_background_is_not_stopped_by_its_question() -> None:
    """The kernel would stop it for using the terminal of another program, and its drives would trip."""
    done = subprocess.run(
        [sys.executable, "-c", _IN_THE_BACKGROUND], capture_output=True, text=True, timeout=300, check=True
    )
    assert "in the background of its terminal" in done.stdout


def test_a_question_fits_a_terminal_of_40_columns(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Status, question and keys are wrapped between words, without colour; the bell rings once."""
    monkeypatch.setenv("COLUMNS", "40")
    monkeypatch.setenv("TERM", "xterm")
    own_end, other_end = os.openpty()
    with os.fdopen(other_end, "w", encoding="utf-8") as stream, redirect_stderr(stream):
        assert terminal.ask(REQUEST, "x\n", "y\n", offer=OFFERED).confirmed
        stream.flush()
        shown = os.read(own_end, 65536).decode()
    os.close(own_end)
    assert (shown.count("\a"), "\x1b" in shown) == (1, False)
    assert max(map(len, shown.replace("\a", "").splitlines())) <= 40


def test_a_pause_without_a_terminal_waits_until_it_is_ended_from_elsewhere(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Nobody can press a key there, and nothing is answered by itself; it says what ends the pause."""
    looks: list[int] = []

    def look() -> None:
        looks.append(1)
        if len(looks) == 2:
            raise KeyError

    operator = TerminalOperator(SignalNote(), io.StringIO(""))
    with pytest.raises(KeyError):
        operator.ask(Paused("after this insertion"), look)
    assert "Paused after this insertion." in (told := capsys.readouterr().err)
    assert "labrig continue" in told


def test_the_first_ctrl_c_pauses_and_the_second_stops() -> None:
    """Only INT does, where a run is made at a terminal; at a question, or while a device does not answer, it stops."""
    note = SignalNote()
    with note.pausing(enabled=True):
        note.take(signal.SIGINT, None)
        assert (note(), note.asks_for_pause) == (None, True)
        note.asks_for_pause = False  # the pause has begun
        with note.pausing(enabled=False):
            pass
        note.take(signal.SIGINT, None)
        assert (note(), note.insist(), note()) == (None, "SIGINT", "SIGINT")
    for number, enabled in ((15, True), (1, True), (2, False)):
        stopping = SignalNote()
        with stopping.pausing(enabled=enabled):
            stopping.take(number, None)
        assert stopping() == signal.Signals(number).name
    twice = SignalNote()
    with twice.pausing(enabled=True):
        twice.take(signal.SIGINT, None)
        twice.take(signal.SIGINT, None)
    assert twice() == "SIGINT"


def find_address(told: str) -> str | None:
    """Return the address at which a person is told to click."""
    found = re.search(r"or click at (\S+)", told)
    return None if found is None else found[1]


def click(address: str, u: int, v: int) -> tuple[int, str]:
    """Confirm a pixel on the page of a question, and return the reply."""
    try:
        with urlopen(f"{address}answer?u={u}&v={v}", timeout=300) as reply:
            return reply.status, reply.read().decode()
    except HTTPError as refusal:
        with refusal:
            return refusal.code, refusal.read().decode()


def test_a_pixel_may_be_clicked(
    tmp_path: Path, terminal: Terminal, capsys: pytest.CaptureFixture[str]
) -> None:
    """A pixel that is confirmed on the page is the answer that typing it gives, and both sides are told."""
    file = tmp_path / "000003.png"
    file.write_bytes(cv2.imencode(".png", np.full((40, 60), 90, np.uint8))[1].tobytes())
    told, clicks = list[str](), list[Future[tuple[int, str]]]()
    with ThreadPoolExecutor(1) as browser:

        def look() -> None:
            told.append(capsys.readouterr().err)
            address = find_address("".join(told))
            if address is not None and not clicks:
                clicks.append(browser.submit(click, address, 12, 7))

        answer = TerminalOperator(SignalNote(), terminal.stream).ask(PickTarget(str(file)), look)
    assert (answer.confirmed, answer.pixel, answer.note) == (True, (12.0, 7.0), "12 7, clicked")
    assert clicks[0].result() == (200, "12 7 is taken. You can close this page.")
    assert "12 7, clicked" in "".join(told) + capsys.readouterr().err


def test_only_the_first_answer_is_taken(capsys: pytest.CaptureFixture[str]) -> None:
    """A pixel that is confirmed after another answer was taken is told so."""
    page = PixelPage(np.full((40, 60), 90, np.uint8), "Where is it?")
    typed = Answer(confirmed=True, note="5 6", pixel=(5.0, 6.0))
    assert page.settle(typed) is typed
    address = find_address(capsys.readouterr().err)
    assert address is not None
    assert click(address, 3, 4) == (409, "3 4 is not taken: another answer came first.")
    page.close()
