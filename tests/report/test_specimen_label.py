"""Labels of specimens."""

import re
import xml.etree.ElementTree as ET

import cv2
import numpy as np
import pytest

from labrig.protocol.specimen_file import SpecimenFile
from labrig.report.specimen_label import draw_label
from tests.protocol.specimens import CAST_ON

SVG = "{http://www.w3.org/2000/svg}"


def label(**values: object) -> ET.Element:
    """Return the label of a specimen as XML."""
    given = {"name": "A1", "gelatin_percent": 10.0, "cast_on": CAST_ON, **values}
    return ET.fromstring(draw_label(SpecimenFile.model_validate(given)))


def read_code(drawn: ET.Element) -> str:
    """Return what OpenCV reads from the code, eight pixels a module."""
    path = next(part for part in drawn.iter(f"{SVG}path") if part.get("class") == "qrline")
    side = int(drawn.find(f".//{SVG}svg").get("width"))
    modules = np.full((side, side), 255, np.uint8)
    x, y = 0.0, 0.0
    for command, text in re.findall(r"([Mmh])([^Mmh]*)", path.get("d")):
        numbers = [float(number) for number in re.findall(r"-?[\d.]+", text)]
        if command == "h":
            modules[int(y), int(x) : int(x + numbers[0])] = 0
            x += numbers[0]
        else:
            x, y = (numbers[0], numbers[1]) if command == "M" else (x + numbers[0], y + numbers[1])
    read, *_ = cv2.QRCodeDetector().detectAndDecode(np.kron(modules, np.ones((8, 8), np.uint8)))
    return read


@pytest.mark.parametrize("name", ["A1", "Gel é 7", "x" * 64])
def test_the_code_holds_the_name(name: str) -> None:
    """A reader that nobody here wrote finds the name of the specimen in the code."""
    assert read_code(label(name=name)) == name


def test_text_is_escaped_and_keeps_to_its_room() -> None:
    """Markup in a free field stays text, and a line that would be too long is cut and pressed together."""
    drawn = label(batch="<script>alert(1)</script>" * 7, usable_until="2026-11-27T09:30+01:00")
    lines = {line.text: line for line in drawn.iter(f"{SVG}text")}
    assert {"A1", "gelatin 10 %", "cast 2026-11-20 09:30", "use until 2026-11-27 09:30"} <= lines.keys()
    batch = next(line for text, line in lines.items() if text.startswith("batch <script>"))
    assert (len(batch.text), batch.get("textLength"), lines["A1"].get("textLength")) == (36, "32.0", None)
    assert not list(drawn.iter(f"{SVG}script"))
