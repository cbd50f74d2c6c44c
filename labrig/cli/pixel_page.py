"""A page beside a question for a pixel, in which the pixel is clicked instead of typed.

It is a process of its own, and nothing waits for it: a browser costs the supervision of the axes nothing.
"""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO, cast

from labrig.cli.output import say
from labrig.cli.typed_lines import TypedLines
from labrig.devices.clocks import SystemClock
from labrig.devices.operator import OperatorRequest, PickPixel

TAKEN = "taken"
"""What the process reads when a pixel is the answer."""

_LOOK_S = 0.02
_ENDED_WITHIN_S = 2.0


class PixelPage:
    """The page of one question.

    Parameters
    ----------
    picture : Path
        File of the picture.
    question : str
        What is asked.
    """

    def __init__(self, picture: Path, question: str) -> None:
        self._process = subprocess.Popen(
            (sys.executable, "-m", "labrig.cli.pixel_page_process"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,
        )
        assert self._process.stdout is not None
        self._lines = TypedLines(cast("TextIO", self._process.stdout))
        self._is_open = False
        self._write(json.dumps({"picture": str(picture), "question": question}))

    def take(self) -> str | None:
        """Return a pixel that was confirmed, as it would be typed; None without one. Says where the page is."""
        for line in self._lines.take():
            if self._is_open:
                return line
            self._is_open = True
            say(f"   or click at {line}", 3)
        return None

    def confirm(self) -> None:
        """Tell the person at the page that the pixel is the answer."""
        self._write(TAKEN)

    def finish(self, meanwhile: Callable[[], None]) -> None:
        """Close the question, and call `meanwhile` until the process has told that to the page."""
        clock = SystemClock()
        until_s = clock.now_s() + _ENDED_WITHIN_S
        self._end_input()
        while self._process.poll() is None and clock.now_s() < until_s:
            clock.sleep(_LOOK_S)
            meanwhile()

    def close(self) -> None:
        """End the process."""
        self._end_input()
        self._process.kill()
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def _end_input(self) -> None:
        if self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.close()

    def _write(self, line: str) -> None:
        """Write a line; a process that has ended gets none."""
        assert self._process.stdin is not None
        with suppress(OSError):
            self._process.stdin.write(f"{line}\n")
            self._process.stdin.flush()


@contextmanager
def offer_page(request: OperatorRequest, meanwhile: Callable[[], None]) -> Iterator[PixelPage | None]:
    """Offer a page beside a question for a pixel; None for other questions, or where the picture is not a file."""
    picture = Path(request.picture) if isinstance(request, PickPixel) else None
    if picture is None or not picture.is_file():
        yield None
        return
    try:
        page = PixelPage(picture, request.text)
    except OSError:  # no more processes: the pixel is typed
        yield None
        return
    try:
        yield page
        page.finish(meanwhile)
    finally:
        page.close()
