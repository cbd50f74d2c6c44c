"""Asks the person at the rig, at the terminal."""

import math
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext, suppress
from typing import TYPE_CHECKING, TextIO

from labrig.cli.output import CONTROLS, SPEAKS_JSON, SafeStandardError, say
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
)
from labrig.errors import InterruptedRunError, SafetyStopError
from labrig.posix import discard_typed, is_in_background, read_typed, wait_for_input

if TYPE_CHECKING:
    from labrig.cli.pixel_page import PixelPage

_KEYS: Mapping[str, tuple[Choice, str]] = {
    "r": (Choice.REPEAT, "repeat the last one"),
    "s": (Choice.SKIP, "skip this one"),
    "b": (Choice.MARK_BAD, "mark bad"),
    "t": (Choice.NOTE, "note"),
    "u": (Choice.UNDO, "undo"),
}
"""What each key chooses, and what a person reads beside it."""

_TEXTS: Mapping[Choice, str] = {Choice.MARK_BAD: "why is it bad", Choice.NOTE: "note"}
"""The choices that need a text, and how it is asked for."""

_WANTED: Mapping[type[OperatorRequest], str] = {
    Paused: "c to continue",
    ReadLength: "a number such as 12.5",
    PickPixel: "two numbers such as 640 290.5",
}
"""What answers a request of a kind; any other wants a yes."""

_LOOK_S = 0.05


class TerminalOperator:
    """Prints what is to be done and waits for the answer; the axes hold still meanwhile.

    What was typed before a question was shown answers nothing; a mark or a note with its text is taken. Each answer is
    a line, so that a key that is hit by accident moves nothing.

    Parameters
    ----------
    interrupted : SignalNote
        Notes signals; during a question each of them stops.
    terminal : TextIO
        Where the person types.
    """

    def __init__(self, interrupted: SignalNote, terminal: TextIO) -> None:
        self._interrupted = interrupted
        self._terminal = terminal

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
            if not self._terminal.isatty():
                self._refuse(request, meanwhile, "nobody is there to answer", "run labrig in a terminal")
            if is_in_background(self._terminal):
                where = "nobody can answer a labrig in the background of its terminal"
                self._refuse(request, meanwhile, where, "run it in the foreground")
            stream = SafeStandardError()
            stream.write("\a" if stream.isatty() and not SPEAKS_JSON.get() else "")
            try:
                with hold_bar(), _offer_page(request) as page:
                    return self._ask(request, meanwhile, offer, page)
            except OSError as error:
                raise SafetyStopError(
                    "the terminal closed before the operator answered",
                    "run labrig in a terminal that stays, such as tmux",
                ) from error

    def _refuse(self, request: OperatorRequest, meanwhile: Callable[[], None], why: str, hint: str) -> None:
        """Raise why nobody can answer; a pause is waited for until `meanwhile` or a signal ends it."""
        if isinstance(request, Paused):
            say(f"{request.text} labrig continue, in another terminal, ends the pause.")
            while True:
                SystemClock().sleep(_LOOK_S)
                self._look_after(meanwhile)
        raise SafetyStopError(f"{why}: {request.text}", hint)

    def _look_after(self, meanwhile: Callable[[], None]) -> None:
        """Look after the rig, and for a signal."""
        meanwhile()
        if self._interrupted() is not None:
            raise InterruptedRunError(f"interrupted by {self._interrupted()}")

    def _ask(
        self, request: OperatorRequest, meanwhile: Callable[[], None], offer: Offer, page: "PixelPage | None"
    ) -> Answer:
        """Ask at the terminal, and on a page too; the answer that comes first counts."""
        wanted = next((words for kind, words in _WANTED.items() if isinstance(request, kind)), "yes")
        keys = "".join(
            f", {key}{' TEXT' if choice in _TEXTS else ''} to {words}"
            for key, (choice, words) in _KEYS.items()
            if choice in offer.choices
        )
        remark, lead = "", f"\n{offer.status}\n" if offer.status else "\n"
        while True:
            say(f"{lead}>> {request.text}", 3)
            while wait_for_input(self._terminal, 0.0) and (typed := read_typed(self._terminal)):
                early = _clean(typed)
                taken = early[:2].lower() in {"b ", "t "} and self._read_choice(early, offer, meanwhile)
                if taken:
                    return taken  # the lines behind it wait for this to be asked again
            discard_typed(self._terminal)
            say(f"   {remark}{wanted}{keys}, or no to stop: ", 3)
            line = self._read_line(meanwhile, page)
            answer = _read_answer(request, line.lower()) or self._read_choice(line, offer, meanwhile)
            if page is not None and (answer is not None or page.answer is not None):
                answer = page.settle(answer)
            if answer is not None:
                return answer
            remark, lead = f"{line[:40]!r} is not understood: " if line not in {"", "?"} else "", "\n"

    def _read_choice(self, line: str, offer: Offer, meanwhile: Callable[[], None]) -> Answer | None:
        """Return what was chosen instead of an answer, with its text; None if nothing was, or the text is empty."""
        key, _, text = line.partition(" ")
        choice, words = _KEYS.get(key.lower(), (None, ""))
        if choice is None or choice not in offer.choices or (text and choice not in _TEXTS):
            return None
        if choice in _TEXTS and not text:
            say(f"   {_TEXTS[choice]}: ", 3)
            text = self._read_line(meanwhile)
            if not text:
                return None
        say(f"   {line}: taken ({words})", 3)
        return Answer(confirmed=False, note=text.strip(), choice=choice)

    def _read_line(self, meanwhile: Callable[[], None], page: "PixelPage | None" = None) -> str:
        """Wait for a line, and return it without control characters; empty if the page has an answer.

        Signals are checked for, and the rig is looked after, twenty times a second.
        """
        typed = b""
        meanwhile()  # at least once: a replay of a pause counts on it
        while not typed.endswith((b"\n", b"\r")):
            if wait_for_input(self._terminal, _LOOK_S):
                more = read_typed(self._terminal)
                if not more:
                    raise SafetyStopError(
                        "standard input ended before the operator answered", "run labrig in a terminal"
                    )
                typed += more
                continue
            self._look_after(meanwhile)
            if page is not None and page.answer is not None:
                return ""
        return _clean(typed)


def _clean(typed: bytes) -> str:
    """Return the first line of what was typed, without control characters."""
    return CONTROLS.sub("", typed.splitlines()[0].decode("utf-8", "replace").replace("\t", " ")).strip()


def _offer_page(request: OperatorRequest) -> AbstractContextManager["PixelPage | None"]:
    """Offer a page to click on, where a pixel is asked for; what draws it takes a second to load."""
    if not isinstance(request, PickPixel):
        return nullcontext()
    from labrig.cli.pixel_page import offer_page

    return offer_page(request)


def _read_answer(request: OperatorRequest, typed: str) -> Answer | None:
    """Return the answer in a line; None if it holds none."""
    if typed in {"n", "no"}:
        return Answer(confirmed=False, note=typed)
    match request:
        case ReadLength():
            numbers = _read_finite(typed.replace(",", "."))
            return Answer(confirmed=True, note=typed, reading=numbers[0]) if len(numbers) == 1 else None
        case PickPixel():
            numbers = _read_finite(typed)
            pixel = (numbers[0], numbers[1]) if len(numbers) == 2 else None
            return None if pixel is None else Answer(confirmed=True, note=typed, pixel=pixel)
    agreed = {"c", "continue"} if isinstance(request, Paused) else {"y", "yes"}
    return Answer(confirmed=True, note=typed) if typed in agreed else None


def _read_finite(text: str) -> list[float]:
    """Return the numbers of an answer; none if a word is not a finite number."""
    with suppress(ValueError):
        numbers = [float(word) for word in text.split()]
        return numbers if all(map(math.isfinite, numbers)) else []
    return []
