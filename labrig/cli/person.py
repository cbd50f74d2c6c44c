"""The person at the bench, asked at the terminal."""

import math
from collections.abc import Callable
from contextlib import suppress
from typing import TextIO

from labrig.cli.output import say
from labrig.cli.signals import SignalNote
from labrig.devices import Answer, OperatorRequest, PickTarget, ReadScale
from labrig.errors import InterruptedRunError, SafetyStopError
from labrig.posix import wait_for_input


class TerminalOperator:
    """Prints what is to be done and waits for yes or no; the axes hold still meanwhile."""

    def __init__(self, interrupted: SignalNote, terminal: TextIO) -> None:
        self._interrupted = interrupted
        self._terminal = terminal

    def ask(self, request: OperatorRequest, meanwhile: Callable[[], None]) -> Answer:
        """Ask until the answer is yes or no.

        Raises
        ------
        SafetyStopError
            When nobody can answer: standard input is closed or no terminal.
        InterruptedRunError
            When a signal arrives during the prompt.
        """
        if not self._terminal.isatty():
            raise SafetyStopError(
                f"nobody is there to answer: {request.text}",
                "run labrig in a terminal; --yes never answers on a real rig",
            )
        if isinstance(request, ReadScale):
            return self._ask_number(request, meanwhile)
        if isinstance(request, PickTarget):
            return self._ask_pixel(request, meanwhile)
        while True:
            say(f"\n>> {request.text}\n   yes, or no to stop: ")
            answer = self._read_line(meanwhile).strip().lower()
            if answer in {"y", "yes"}:
                return Answer(confirmed=True, note=answer)
            if answer in {"n", "no"}:
                return Answer(confirmed=False, note=answer)

    def _ask_number(self, request: ReadScale, meanwhile: Callable[[], None]) -> Answer:
        """Ask until the answer is a number, or no."""
        while True:
            say(f"\n>> {request.text}\n   a number, or no to stop: ")
            answer = self._read_line(meanwhile).strip().lower()
            if answer in {"n", "no"}:
                return Answer(confirmed=False, note=answer)
            with suppress(ValueError):
                reading = float(answer.replace(",", "."))
                if math.isfinite(reading):
                    return Answer(confirmed=True, note=answer, reading=reading)

    def _ask_pixel(self, request: PickTarget, meanwhile: Callable[[], None]) -> Answer:
        """Ask until the answer is two numbers, or no."""
        while True:
            say(f"\n>> {request.text}\n   two numbers, or no to stop: ")
            answer = self._read_line(meanwhile).strip().lower()
            if answer in {"n", "no"}:
                return Answer(confirmed=False, note=answer)
            with suppress(ValueError):
                u, v = (float(one) for one in answer.split())
                if math.isfinite(u) and math.isfinite(v):
                    return Answer(confirmed=True, note=answer, pixel=(u, v))

    def _read_line(self, meanwhile: Callable[[], None]) -> str:
        """Wait for a line, looking for signals and after the rig twenty times a second."""
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
