"""Asks the person at the rig, at the terminal."""

import math
from collections.abc import Callable
from contextlib import suppress
from typing import TextIO, TypeVar

from labrig.cli.output import say_wrapped
from labrig.cli.progress import hold_bar
from labrig.cli.signals import SignalNote
from labrig.devices.operator import Answer, OperatorRequest, PickTarget, ReadScale
from labrig.errors import InterruptedRunError, SafetyStopError
from labrig.posix import discard_typed, is_in_background, read_typed, wait_for_input

_T = TypeVar("_T")


class TerminalOperator:
    """Prints what is to be done and waits for the answer; the axes hold still meanwhile.

    What was typed before a question was shown answers nothing.
    """

    def __init__(self, interrupted: SignalNote, terminal: TextIO) -> None:
        self._interrupted = interrupted
        self._terminal = terminal

    def ask(self, request: OperatorRequest, meanwhile: Callable[[], None]) -> Answer:
        """Ask until the answer is understood.

        Raises
        ------
        SafetyStopError
            When nobody can answer: standard input is not a terminal, has closed, or belongs to another program.
        InterruptedRunError
            When a signal arrives during the prompt.
        """
        if not self._terminal.isatty():
            raise SafetyStopError(
                f"nobody is there to answer: {request.text}",
                "run labrig in a terminal; --yes never answers on a real rig",
            )
        if is_in_background(self._terminal):
            raise SafetyStopError(
                f"nobody can answer a labrig in the background of its terminal: {request.text}",
                "run it in the foreground",
            )
        wanted, read_answer = _choose_reader(request)
        with hold_bar():
            return self._ask(request, meanwhile, wanted, read_answer)

    def _ask(
        self,
        request: OperatorRequest,
        meanwhile: Callable[[], None],
        wanted: str,
        read_answer: Callable[[str], Answer | None],
    ) -> Answer:
        """Ask until the answer is understood or no; say what is wanted if it is neither."""
        remark = ""
        while True:
            say_wrapped(f"\n>> {request.text}", 3)
            self._use_terminal(discard_typed)
            say_wrapped(f"   {remark}{wanted}, or no to stop: ", 3)
            typed = self._read_line(meanwhile).strip().lower()
            if typed in {"n", "no"}:
                return Answer(confirmed=False, note=typed)
            if (answer := read_answer(typed)) is not None:
                return answer
            remark = f"{typed!r} is not understood: " if typed else ""

    def _read_line(self, meanwhile: Callable[[], None]) -> str:
        """Wait for a line; check for signals and look after the rig twenty times a second."""
        typed = b""
        while not typed.endswith((b"\n", b"\r")):
            if not wait_for_input(self._terminal, 0.05):
                meanwhile()
                if self._interrupted() is not None:
                    raise InterruptedRunError(f"interrupted by {self._interrupted()}")
                continue
            more = self._use_terminal(read_typed)
            if not more:
                raise SafetyStopError(
                    "standard input ended before the operator answered", "run labrig in a terminal"
                )
            typed += more
        return typed.splitlines()[0].decode("utf-8", "replace")

    def _use_terminal(self, use: Callable[[TextIO], _T]) -> _T:
        try:
            return use(self._terminal)
        except OSError as error:
            raise SafetyStopError(
                "the terminal closed before the operator answered",
                "run labrig in a terminal that stays, such as tmux",
            ) from error


def _choose_reader(request: OperatorRequest) -> tuple[str, Callable[[str], Answer | None]]:
    """Return what the answer to a request looks like, and what reads it."""
    match request:
        case ReadScale():
            return "a number such as 12.5", _read_number
        case PickTarget():
            return "two numbers such as 640 290.5", _read_pixel
        case _:
            return "yes", _read_consent


def _read_consent(typed: str) -> Answer | None:
    return Answer(confirmed=True, note=typed) if typed in {"y", "yes"} else None


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
