"""Asks the person at the rig, at the terminal."""

import math
from collections.abc import Callable
from contextlib import suppress
from typing import TextIO

from labrig.cli.output import say
from labrig.cli.signals import SignalNote
from labrig.devices.operator import Answer, OperatorRequest, PickTarget, ReadScale
from labrig.errors import InterruptedRunError, SafetyStopError
from labrig.posix import wait_for_input


class TerminalOperator:
    """Prints what is to be done and waits for the answer; the axes hold still meanwhile."""

    def __init__(self, interrupted: SignalNote, terminal: TextIO) -> None:
        self._interrupted = interrupted
        self._terminal = terminal

    def ask(self, request: OperatorRequest, meanwhile: Callable[[], None]) -> Answer:
        """Ask until the answer is understood.

        Raises
        ------
        SafetyStopError
            When nobody can answer: standard input is closed or is not a terminal.
        InterruptedRunError
            When a signal arrives during the prompt.
        """
        if not self._terminal.isatty():
            raise SafetyStopError(
                f"nobody is there to answer: {request.text}",
                "run labrig in a terminal; --yes never answers on a real rig",
            )
        match request:
            case ReadScale():
                return self._ask(request, meanwhile, "a number such as 12.5", _read_number)
            case PickTarget():
                return self._ask(request, meanwhile, "two numbers such as 640 290.5", _read_pixel)
            case _:
                return self._ask(request, meanwhile, "yes", _read_consent)

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
            say(f"\n>> {request.text}\n   {remark}{wanted}, or no to stop: ")
            typed = self._read_line(meanwhile).strip().lower()
            if typed in {"n", "no"}:
                return Answer(confirmed=False, note=typed)
            if (answer := read_answer(typed)) is not None:
                return answer
            remark = f"{typed!r} is not understood: " if typed else ""

    def _read_line(self, meanwhile: Callable[[], None]) -> str:
        """Wait for a line; check for signals and look after the rig twenty times a second."""
        while not wait_for_input(self._terminal, 0.05):
            meanwhile()
            if self._interrupted() is not None:
                raise InterruptedRunError(f"interrupted by {self._interrupted()}")
        line = self._terminal.readline()
        if not line:
            raise SafetyStopError(
                "standard input ended before the operator answered", "run labrig in a terminal"
            )
        return line


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
