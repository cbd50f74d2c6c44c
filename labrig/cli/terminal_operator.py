"""Asks the person at the rig, at the terminal."""

import math
import re
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, TextIO, TypeVar

from labrig.cli.output import CONTROLS, ring_bell, say
from labrig.cli.progress import hold_bar
from labrig.cli.signals import SignalNote
from labrig.devices.clocks import SystemClock
from labrig.devices.operator import (
    NO_OFFER,
    Answer,
    Choice,
    Offer,
    OperatorRequest,
    Paused,
    PickPixel,
    ReadLength,
    ReadScale,
)
from labrig.errors import InterruptedRunError, SafetyStopError
from labrig.posix import discard_typed, is_in_background, read_typed, wait_for_input

if TYPE_CHECKING:
    from labrig.cli.pixel_page import PixelPage

_T = TypeVar("_T")

_KEYS: Mapping[Choice, tuple[str, str]] = {
    Choice.PAUSE: ("p", "pause"),
    Choice.REPEAT: ("r", "repeat the last one"),
    Choice.SKIP: ("s", "skip this one"),
    Choice.MARK_BAD: ("b", "mark bad"),
    Choice.NOTE: ("t", "note"),
    Choice.UNDO: ("u", "undo"),
}
"""The key of each choice, and what a person reads beside it."""

_TEXTS: Mapping[Choice, str] = {Choice.MARK_BAD: "why is it bad", Choice.NOTE: "note"}
"""The choices that need a text, and how it is asked for."""

_SEQUENCES = re.compile(r"\x1b(?:\[[0-?]*[ -/]*[@-~]|\][^\x07\x1b]*(?:\x07|\x1b\\)?|.)?")
"""Escape sequences, such as those of arrow keys or of a pasted text."""

_LONGEST_TEXT = 2000
_LOOK_S = 0.05


class TerminalOperator:
    """Prints what is to be done and waits for the answer; the axes hold still meanwhile.

    What was typed before a question was shown answers nothing. Each answer is a line, so that a key that is hit by
    accident moves nothing.

    Parameters
    ----------
    interrupted : SignalNote
        Notes signals; during a question each of them stops.
    terminal : TextIO
        Where the person types.
    rings : bool
        Whether the bell of the terminal rings at each question.
    """

    def __init__(self, interrupted: SignalNote, terminal: TextIO, *, rings: bool = False) -> None:
        self._interrupted = interrupted
        self._terminal = terminal
        self._rings = rings

    def ask(self, request: OperatorRequest, meanwhile: Callable[[], None], offer: Offer = NO_OFFER) -> Answer:
        """Ask until the answer is understood.

        A pause without a terminal waits for `meanwhile` to end it.

        Raises
        ------
        SafetyStopError
            When nobody can answer: standard input is not a terminal, has closed, or belongs to another program.
        InterruptedRunError
            When a signal arrives during the prompt.
        """
        with self._interrupted.pausing(enabled=False):
            nobody = self._find_nobody(request)
            if nobody is not None and isinstance(request, Paused):
                say(f"{request.text} labrig continue, in another terminal, ends the pause.")
                self._wait(meanwhile)
            if nobody is not None:
                raise nobody
            if self._rings:
                ring_bell()
            with hold_bar():
                return self._ask(request, meanwhile, offer)

    def _find_nobody(self, request: OperatorRequest) -> SafetyStopError | None:
        """Return why nobody can answer; None if somebody can."""
        if not self._terminal.isatty():
            return SafetyStopError(
                f"nobody is there to answer: {request.text}",
                "run labrig in a terminal; --yes never answers on a real rig",
            )
        if is_in_background(self._terminal):
            return SafetyStopError(
                f"nobody can answer a labrig in the background of its terminal: {request.text}",
                "run it in the foreground",
            )
        return None

    def _wait(self, meanwhile: Callable[[], None]) -> None:
        """Wait until `meanwhile` or a signal ends it."""
        clock = SystemClock()
        while self._interrupted() is None:
            clock.sleep(_LOOK_S)
            meanwhile()
        raise InterruptedRunError(f"interrupted by {self._interrupted()}")

    def _ask(self, request: OperatorRequest, meanwhile: Callable[[], None], offer: Offer) -> Answer:
        """Ask until the answer is understood or no; say what is wanted if it is neither."""
        with _offer_page(request, meanwhile) as page:
            return self._ask_beside(page, request, meanwhile, offer)

    def _ask_beside(
        self, page: "PixelPage | None", request: OperatorRequest, meanwhile: Callable[[], None], offer: Offer
    ) -> Answer:
        """Ask at the terminal, and take the answer of a page too; the one that is read first counts."""
        wanted, read_answer = _choose_reader(request)
        keys = "".join(f", {' '.join(_KEYS[choice])}" for choice in offer.choices)
        remark, lead = "", f"\n{offer.status}\n" if offer.status else "\n"
        while True:
            say(f"{lead}>> {request.text}", 3)
            self._use_terminal(discard_typed)
            say(f"   {remark}{wanted}{keys}, or no to stop: ", 3)
            line, clicked = self._read_line_or_click(meanwhile, page)
            typed = line.lower()
            if typed in {"n", "no"}:
                return Answer(confirmed=False, note=typed)
            if (answer := read_answer(typed)) is not None:
                return _confirm_click(page, answer) if clicked else answer
            if (chosen := self._read_choice(line, offer, meanwhile)) is not None:
                return chosen
            remark, lead = _explain(typed, offer), "\n"

    def _read_choice(self, line: str, offer: Offer, meanwhile: Callable[[], None]) -> Answer | None:
        """Return what was chosen instead of an answer, with its text; None if nothing was, or the text is empty."""
        key, _, text = line.partition(" ")
        choice = next((choice for choice in offer.choices if key.lower() == _KEYS[choice][0]), None)
        if choice is None or (text and choice not in _TEXTS):
            return None
        if choice in _TEXTS:
            if not text.strip():
                say(f"   {_TEXTS[choice]}: ", 3)
                text = self._read_line(meanwhile)
            if len(text) > _LONGEST_TEXT:
                say(f"   only its first {_LONGEST_TEXT} characters are kept", 3)
                text = text[:_LONGEST_TEXT]
            if not text.strip():
                return None
        say(f"   {_KEYS[choice][1]}: taken", 3)
        return Answer(confirmed=False, note=text.strip(), choice=choice)

    def _read_line(self, meanwhile: Callable[[], None]) -> str:
        return self._read_line_or_click(meanwhile, None)[0]

    def _read_line_or_click(
        self, meanwhile: Callable[[], None], page: "PixelPage | None"
    ) -> tuple[str, bool]:
        """Wait for a line, and return it without control characters, and whether it comes from the page.

        Signals are checked for, and the rig is looked after, twenty times a second.
        """
        typed = b""
        meanwhile()  # at least once: a replay of a pause counts on it
        while not typed.endswith((b"\n", b"\r")):
            if not wait_for_input(self._terminal, _LOOK_S):
                meanwhile()
                if self._interrupted() is not None:
                    raise InterruptedRunError(f"interrupted by {self._interrupted()}")
                # What was typed meanwhile comes first.
                if page is not None and not wait_for_input(self._terminal, 0.0):
                    click = page.take()
                    if click is not None:
                        return click, True
                continue
            more = self._use_terminal(read_typed)
            if not more:
                raise SafetyStopError(
                    "standard input ended before the operator answered", "run labrig in a terminal"
                )
            typed += more
        return _clean(typed.splitlines()[0].decode("utf-8", "replace")), False

    def _use_terminal(self, use: Callable[[TextIO], _T]) -> _T:
        try:
            return use(self._terminal)
        except OSError as error:
            raise SafetyStopError(
                "the terminal closed before the operator answered",
                "run labrig in a terminal that stays, such as tmux",
            ) from error


def _offer_page(
    request: OperatorRequest, meanwhile: Callable[[], None]
) -> AbstractContextManager["PixelPage | None"]:
    """Offer a page to click on, where a pixel is asked for; what draws it takes a second to load."""
    if not isinstance(request, PickPixel):
        return nullcontext()
    from labrig.cli.pixel_page import offer_page

    return offer_page(request, meanwhile)


def _confirm_click(page: "PixelPage | None", answer: Answer) -> Answer:
    """Tell page and terminal that a click is the answer, and return it with a note of that."""
    if page is not None:
        page.confirm()
    note = f"{answer.note}, clicked"
    say(f"   {note}", 3)
    return replace(answer, note=note)


def _choose_reader(request: OperatorRequest) -> tuple[str, Callable[[str], Answer | None]]:
    """Return what the answer to a request looks like, and what reads it."""
    match request:
        case Paused():
            return "c to continue", _read_continuation
        case ReadScale() | ReadLength():
            return "a number such as 12.5", _read_number
        case PickPixel():
            return "two numbers such as 640 290.5", _read_pixel
        case _:
            return "yes", _read_consent


def _read_consent(typed: str) -> Answer | None:
    return Answer(confirmed=True, note=typed) if typed in {"y", "yes"} else None


def _read_continuation(typed: str) -> Answer | None:
    return Answer(confirmed=True, note=typed) if typed in {"c", "continue", "y", "yes"} else None


def _read_number(typed: str) -> Answer | None:
    numbers = _read_finite(typed.replace(",", ".").split())
    return Answer(confirmed=True, note=typed, reading=numbers[0]) if len(numbers) == 1 else None


def _read_pixel(typed: str) -> Answer | None:
    numbers = _read_finite(typed.split())
    return Answer(confirmed=True, note=typed, pixel=(numbers[0], numbers[1])) if len(numbers) == 2 else None


def _read_finite(words: list[str]) -> list[float]:
    """Return the numbers of an answer; none if a word is not a finite number."""
    with suppress(ValueError):
        numbers = [float(word) for word in words]
        return numbers if all(map(math.isfinite, numbers)) else []
    return []


def _clean(line: str) -> str:
    """Return a typed line without escape sequences and control characters."""
    return CONTROLS.sub("", _SEQUENCES.sub("", line).replace("\t", " ")).strip()


def _explain(typed: str, offer: Offer) -> str:
    """Return what is wrong with a line that is no answer; nothing about an empty one."""
    for choice, (key, words) in _KEYS.items():
        if typed.partition(" ")[0] == key and choice not in offer.choices:
            return f"{words} is not possible now: "
    return f"{_shorten(typed)!r} is not understood: " if typed else ""


def _shorten(typed: str) -> str:
    return typed if len(typed) <= 40 else f"{typed[:40]}..."
