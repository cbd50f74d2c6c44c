"""A page beside a question for a pixel, in which the pixel is clicked instead of typed."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Thread

from labrig.cli.output import say
from labrig.devices.operator import Answer, PickPixel
from labrig.errors import PictureError
from labrig.report.picture_page import PicturePage, Pixel, ShownPicture, Verdict
from labrig.vision.picture import Picture, read_picture


class PixelPage:
    """The page of one question, served in other threads; of all answers, on the page and at the terminal, one counts.

    Parameters
    ----------
    image : ndarray of uint8, (H, W) or (H, W, 3)
    question : str
        What is asked.
    """

    def __init__(self, image: Picture, question: str) -> None:
        self._answers: list[Answer] = []
        self._page = PicturePage(self._take)
        self._page.show(ShownPicture(0, image, question))
        say(f"   or click at {self._page.url}", 3)

    @property
    def answer(self) -> Answer | None:
        """The one that came first; None so far."""
        return self._answers[0] if self._answers else None

    def settle(self, answer: Answer | None) -> Answer:
        """Take the answer of the terminal, if there is one, and return the one that came first."""
        if answer is not None:
            self._answers.append(answer)  # which of two threads is first is decided here
        first = self._answers[0]
        if first is not answer:
            say(f"   {first.note}", 3)
        return first

    def close(self) -> None:
        """Take no more answers, and stop serving once everybody who has sent one has a reply."""
        self._answers.append(Answer(confirmed=False))
        Thread(target=self._page.close).start()

    def _take(self, pixel: Pixel) -> Verdict:
        """Take a pixel that was confirmed on the page, if it comes first."""
        u, v = pixel
        answer = Answer(confirmed=True, note=f"{u} {v}, clicked", pixel=(float(u), float(v)))
        self._answers.append(answer)
        if self._answers[0] is answer:
            return Verdict(taken=True, text=f"{u} {v} is taken. You can close this page.")
        return Verdict(taken=False, text=f"{u} {v} is not taken: another answer came first.")


@contextmanager
def offer_page(request: PickPixel) -> Iterator[PixelPage | None]:
    """Offer a page beside a question for a pixel; None where there is no picture or no port: the pixel is typed."""
    page = None
    with suppress(PictureError, OSError):
        page = PixelPage(read_picture(Path(request.picture)), request.text)
    try:
        yield page
    finally:
        if page is not None:
            page.close()
