"""The process that serves a question for a pixel to a browser.

`python -m labrig.cli.pixel_page_process` reads a JSON document with `picture` and `question` on standard input. On
standard output it writes the address of the page, then each pixel that a person confirms, as `u v`. None is the answer
before `taken` was read: whoever asks decides which of two answers came first. The end of standard input closes the
question.
"""

import json
import os
import sys
from pathlib import Path
from threading import Condition, Lock

from labrig.cli.pixel_page import TAKEN
from labrig.errors import LabrigError
from labrig.posix import end_with_parent, lower_priority
from labrig.report.picture_page import PicturePage, Pixel, ShownPicture, Verdict
from labrig.vision.picture import read_picture

_DECIDED_WITHIN_S = 5.0
_REPLIED_WITHIN_S = 1.0


class PixelArbiter:
    """Passes confirmed pixels on, one at a time, and tells each sender whether it was the answer."""

    def __init__(self) -> None:
        self._passing_on = Lock()
        self._decided = Condition()
        self._verdict: bool | None = None

    def take(self, pixel: Pixel) -> Verdict:
        """Pass a pixel on and wait until it is taken, or the question is closed."""
        u, v = pixel
        with self._passing_on, self._decided:
            if self._verdict is None:
                _tell(f"{u} {v}")
                self._decided.wait_for(lambda: self._verdict is not None, _DECIDED_WITHIN_S)
                if self._verdict:
                    return Verdict(taken=True, text=f"{u} {v} is taken. You can close this page.")
            return Verdict(taken=False, text=f"{u} {v} is not taken: another answer came first.")

    def decide(self, *, taken: bool) -> None:
        """Take the pixel that was passed on, or close the question; the first decision holds."""
        with self._decided:
            if self._verdict is None:
                self._verdict = taken
            self._decided.notify_all()


def main() -> None:
    """Serve the page until the question is closed."""
    end_with_parent()
    lower_priority()
    asked = json.loads(sys.stdin.readline())
    arbiter = PixelArbiter()
    try:
        image = read_picture(Path(asked["picture"]))
        page = PicturePage(take=arbiter.take)
    except LabrigError:
        return  # without a page the pixel is typed
    page.show(ShownPicture(0, image, asked["question"]))
    _tell(page.url)
    for line in sys.stdin:
        if line.strip() == TAKEN:
            arbiter.decide(taken=True)
    arbiter.decide(taken=False)
    page.finish_replies(_REPLIED_WITHIN_S)
    os._exit(0)


def _tell(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
