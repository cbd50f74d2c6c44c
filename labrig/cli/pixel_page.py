"""A page beside a question for a pixel, in which the pixel is clicked instead of typed."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Condition, Thread

from labrig.cli.output import say
from labrig.devices.operator import OperatorRequest, PickPixel
from labrig.errors import PictureError
from labrig.report.picture_page import PicturePage, Pixel, ShownPicture, Verdict
from labrig.vision.picture import Picture, read_picture

_LOOK_S = 0.02
_DECIDED_WITHIN_S = 5.0


class PixelPage:
    """The page of one question. A pixel is its answer once the person at the terminal's side has taken it.

    Parameters
    ----------
    image : ndarray of uint8, (H, W) or (H, W, 3)
    question : str
        What is asked.
    """

    def __init__(self, image: Picture, question: str) -> None:
        self._decided = Condition()
        self._clicked: Pixel | None = None
        self._verdict: bool | None = None
        self._page = PicturePage(self._pass_on)
        self._page.show(ShownPicture(0, image, question))
        say(f"   or click at {self._page.url}", 3)

    def take(self) -> str | None:
        """Return a pixel that was confirmed on the page, as it would be typed; None without one."""
        return None if self._clicked is None else f"{self._clicked[0]} {self._clicked[1]}"

    def confirm(self) -> None:
        """Tell the person at the page that the pixel is the answer."""
        self._decide(taken=True)

    def close(self, meanwhile: Callable[[], None]) -> None:
        """Close the question, tell that to the page, and call `meanwhile` until it has been told."""
        self._decide(taken=False)
        closing = Thread(target=self._page.close)
        closing.start()
        while closing.is_alive():
            closing.join(_LOOK_S)
            meanwhile()

    def _decide(self, *, taken: bool) -> None:
        """Take the pixel that was passed on, or close the question; the first decision holds."""
        with self._decided:
            if self._verdict is None:
                self._verdict = taken
            self._decided.notify_all()

    def _pass_on(self, pixel: Pixel) -> Verdict:
        """Pass the first pixel on, and wait until it is taken or the question is closed."""
        u, v = pixel
        with self._decided:
            if self._clicked is None and self._verdict is None:
                self._clicked = pixel
                self._decided.wait_for(lambda: self._verdict is not None, _DECIDED_WITHIN_S)
                if self._verdict:
                    return Verdict(taken=True, text=f"{u} {v} is taken. You can close this page.")
        return Verdict(taken=False, text=f"{u} {v} is not taken: another answer came first.")


@contextmanager
def offer_page(request: OperatorRequest, meanwhile: Callable[[], None]) -> Iterator[PixelPage | None]:
    """Offer a page beside a question for a pixel; None for other questions, or where the picture cannot be read."""
    page = None
    if isinstance(request, PickPixel):
        try:
            page = PixelPage(read_picture(Path(request.picture)), request.text)
        except (PictureError, OSError):  # no picture, or no port: the pixel is typed
            page = None
    try:
        yield page
    finally:
        if page is not None:
            page.close(meanwhile)
