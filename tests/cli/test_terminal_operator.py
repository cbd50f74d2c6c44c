"""Questions to the operator, at a real pseudo-terminal."""

import io
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
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


YES = Answer(confirmed=True, note="yes")
OFFERED = Offer(tuple(Choice), "hole 3 of 18, gel 2 of 4, about 52 minutes of yours and 34 of the rig's left")
NO = Answer(confirmed=False, note="no")


@pytest.mark.parametrize(
    ("request_", "typed", "answer", "told"),
    [
        (REQUEST, "yes", YES, ""),
        (REQUEST, "maybe||Y", replace(YES, note="y"), ""),
        (REQUEST, "s|n", replace(NO, note="n"), ""),
        (PICK, "1020|there|inf 3|10 2.5", Answer(confirmed=True, note="10 2.5", pixel=(10.0, 2.5)), ""),
        (SCALE, "-12,5", Answer(confirmed=True, note="-12,5", reading=-12.5), ""),
        (Paused("after this insertion"), "c", replace(YES, note="c"), ""),
        (Paused("after this insertion"), "no", NO, ""),
        (SCALE, "yes|no", NO, "'yes' is not understood: a number such as 12.5"),
        (PICK, "yes|no", NO, "'yes' is not understood: two numbers such as 640 290.5"),
        (REQUEST, "?|no", NO, f"{REQUEST.text}\n   yes, or no to stop: \n\n>> {REQUEST.text}\n   yes"),
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
    ("typed", "choice", "note"),
    [
        ("R", Choice.REPEAT, ""),
        ("s", Choice.SKIP, ""),
        ("u", Choice.UNDO, ""),
        ("b the picture is blurred", Choice.MARK_BAD, "the picture is blurred"),
        ("t|Bubbles at 3 mm", Choice.NOTE, "Bubbles at 3 mm"),
        ("t||t x", Choice.NOTE, "x"),
        ("t a\x1b[2Jb\x07\u202ec", Choice.NOTE, "a[2Jbc"),
    ],
)
def test_each_choice_has_a_key(
    typed: str, choice: Choice, note: str, terminal: Terminal, capsys: pytest.CaptureFixture[str]
) -> None:
    """A letter chooses; a note and a reason are typed behind it or when asked for, without control characters."""
    answer = terminal.ask(REQUEST, *(f"{line}\n" for line in typed.split("|")), offer=OFFERED)
    assert answer == Answer(confirmed=False, note=note, choice=choice)
    shown = capsys.readouterr().err
    assert f"{OFFERED.status}\n>> " in shown
    assert "s to skip this one, b TEXT to mark bad, t TEXT to note, u to undo, or no to stop: " in shown


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


@pytest.mark.parametrize("early", ["yes\n", "yes", "yes\nyes\nyes\n", "s\nyes\nb dirt\nt x\nyes\n"])
def test_an_answer_typed_before_the_question_does_not_count(early: str, terminal: Terminal) -> None:
    """A yes typed while an axis moved confirms nothing, nor stands before the answer; a mark and a note are taken."""
    terminal.type(early)
    for choice, note in ((Choice.MARK_BAD, "dirt"), (Choice.NOTE, "x")) if "dirt" in early else ():
        assert terminal.ask(REQUEST, offer=OFFERED) == Answer(confirmed=False, note=note, choice=choice)
    assert not terminal.ask(REQUEST, "no\n").confirmed
    assert terminal.ask(REQUEST, "maybe\nyes\nyes\n", "yes\n").note == "yes"
    assert not terminal.ask(REQUEST, "no\n").confirmed


@pytest.mark.parametrize("closes", ["before the question", "during the question"])
def test_a_terminal_that_closes_stops_the_axes(closes: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The window is closed: nobody can answer, and the rig is told so."""

    class Stubborn(io.TextIOWrapper):
        """A terminal that says that it is one even once it has closed."""

        def isatty(self) -> bool:
            return True

    keyboard, screen = os.openpty()
    with Stubborn(os.fdopen(screen, "rb", buffering=0), encoding="utf-8") as terminal:
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


def test_a_pause_without_a_terminal_waits_until_it_is_ended_from_elsewhere(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Nobody can press a key there, and nothing is answered by itself; it says what ends the pause."""
    looks: list[int] = []

    def look() -> None:
        looks.append(1)
        if len(looks) == 2:
            raise KeyError

    with pytest.raises(KeyError):
        TerminalOperator(SignalNote(), io.StringIO("")).ask(Paused("after this insertion"), look)
    assert "Paused after this insertion." in (told := capsys.readouterr().err)
    assert "labrig continue" in told


@pytest.mark.parametrize(
    ("numbers", "enabled", "told"),
    [
        ((signal.SIGINT,), True, None), ((signal.SIGINT, signal.SIGINT), True, "SIGINT"),
        ((signal.SIGINT,), False, "SIGINT"), ((signal.SIGTERM,), True, "SIGTERM"),
        ((signal.SIGHUP,), True, "SIGHUP"),
    ],
)  # fmt: skip
def test_the_first_ctrl_c_pauses_and_the_second_stops(
    numbers: tuple[signal.Signals, ...], enabled: bool, told: str | None
) -> None:
    """Only INT does, where a run is made at a terminal; while a device does not answer, it stops."""
    note = SignalNote()
    with note.pausing(enabled=enabled):
        for number in numbers:
            note.take(number, None)
        assert note() == told
        if told is None:
            assert note.asks_for_pause
            note.asks_for_pause = False  # the pause has begun
            with note.pausing(enabled=False):
                pass
            note.take(signal.SIGINT, None)
            assert (note(), note.insist(), note()) == (None, "SIGINT", "SIGINT")


def click(told: str, u: int, v: int) -> tuple[int, str]:
    """Confirm a pixel on the page of a question that was told, and return the reply."""
    (address,) = re.findall(r"or click at (\S+)", told)
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
            if "or click at" in "".join(told) and not clicks:
                clicks.append(browser.submit(click, "".join(told), 12, 7))

        answer = TerminalOperator(SignalNote(), terminal.stream).ask(PickTarget(str(file)), look)
    assert (answer.confirmed, answer.pixel, answer.note) == (True, (12.0, 7.0), "12 7, clicked")
    assert clicks[0].result() == (200, "12 7 is taken. You can close this page.")
    assert "12 7, clicked" in "".join(told) + capsys.readouterr().err


def test_only_the_first_answer_is_taken(capsys: pytest.CaptureFixture[str]) -> None:
    """A pixel that is confirmed after another answer was taken is told so."""
    page = PixelPage(np.full((40, 60), 90, np.uint8), "Where is it?")
    typed = Answer(confirmed=True, note="5 6", pixel=(5.0, 6.0))
    assert page.settle(typed) is typed
    assert click(capsys.readouterr().err, 3, 4) == (409, "3 4 is not taken: another answer came first.")
    page.close()
