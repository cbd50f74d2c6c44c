"""The page with a camera's picture, as a browser on this computer gets it."""

import json
from collections.abc import Iterator
from contextlib import closing
from http.client import HTTPConnection, HTTPResponse
from urllib.parse import quote, urlsplit

import cv2
import numpy as np
import pytest

from labrig.report.picture_page import PicturePage, Pixel, ShownPicture, Verdict
from labrig.vision.picture_quality import Score

IMAGE = np.arange(40 * 60, dtype=np.uint32).astype(np.uint8).reshape(40, 60)
HOSTILE = "<img src=x onerror=alert(1)>\"'&"


def _take(pixel: Pixel) -> Verdict:
    return Verdict(pixel == (7, 9), f"{pixel[0]} {pixel[1]}")


@pytest.fixture
def page() -> Iterator[PicturePage]:
    """Serve a page that asks for a pixel."""
    with closing(PicturePage(take=_take)) as served:
        served.show(ShownPicture(3, IMAGE, HOSTILE, [Score("focus", None, "", None, HOSTILE)]))
        yield served


def _request(page: PicturePage, name: str, **headers: str) -> tuple[HTTPResponse, bytes]:
    """Ask for a name below the page's address, or for a path that begins with a slash."""
    with closing(HTTPConnection("127.0.0.1", page.port, timeout=300)) as browser:
        browser.request("GET", name if name[:1] == "/" else urlsplit(page.url).path + name, headers=headers)
        reply = browser.getresponse()
        return reply, reply.read()


def test_the_page_and_its_parts_are_served_under_the_token(page: PicturePage) -> None:
    """With a policy under which nothing else is loaded, framed or kept; markup in a heading or a reason is data."""
    for name in ("", "picture.js", "picture.css", "style.css", "icon.svg"):
        reply, content = _request(page, name)
        assert reply.status == 200
        assert "default-src 'none'" in (reply.getheader("Content-Security-Policy") or "")
        told = (reply.getheader("Cache-Control"), reply.getheader("Referrer-Policy"))
        assert told == ("no-store", "no-referrer")
        unsafe = (b"onclick", b"innerHTML", b"insertAdjacentHTML", b"document.write", b"eval(", b"alert")
        assert not [word for word in unsafe if word in content], name
    _, png = _request(page, "picture.png?n=3")
    assert np.array_equal(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED), IMAGE)
    reply, content = _request(page, "state.json")
    state = json.loads(content)
    assert reply.getheader("Content-Type") == "application/json"
    assert (state["heading"], state["scores"][0]["text"]) == (HOSTILE, HOSTILE)


@pytest.mark.parametrize(
    ("name", "headers", "status"),
    [
        ("/", {}, 404), ("/wrong-token/state.json", {}, 404), ("no-such-file", {}, 404),
        ("state.json", {"Host": "labrig.example:80"}, 421), ("state.json", {"Host": "127.0.0.1"}, 421),
        ("answer?u=7&v=9", {}, 200), ("answer?u=8&v=9", {}, 409), ("answer?u=60&v=9", {}, 400),
        ("answer?u=-1&v=9", {}, 400), ("answer?u=7.5&v=9", {}, 400), ("answer?u=7", {}, 400),
        (f"answer?u={'9' * 5000}&v=9", {}, 400), ("answer?u=٣&v=9", {}, 400),
    ],
)  # fmt: skip
def test_only_a_confirmed_pixel_under_the_address_is_taken(
    name: str, headers: dict[str, str], status: int, page: PicturePage
) -> None:
    """Neither another account that guesses, nor a page whose name was bound to this computer, nor what is no pixel."""
    reply, content = _request(page, quote(name, "?=&/"), **headers)
    assert reply.status == status
    assert b"heading" not in content


def test_a_page_that_asks_nothing_takes_nothing() -> None:
    """Before the first picture the state says that there is none."""
    with closing(PicturePage()) as page:
        assert json.loads(_request(page, "state.json")[1])["number"] == -1
        assert _request(page, "answer?u=1&v=1")[0].status == 404
