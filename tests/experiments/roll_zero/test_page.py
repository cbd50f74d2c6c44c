"""The page of a roll zero run: the cosine of the roll, each insertion, and its picture."""

import math
import re
from pathlib import Path

import pytest

from labrig.experiments.roll_zero.result import RollZeroResult
from tests.analysis.synthetic import record_roll_zero
from tests.report.conftest import make_page

ZERO_RAD = math.radians(20.0)


def test_the_zero_is_drawn_and_each_insertion_has_its_line_and_its_picture(tmp_path: Path) -> None:
    """A needle bends towards −y at 20 degrees; the fourth picture shows none, and has no row."""
    page = make_page(record_roll_zero(tmp_path, ZERO_RAD, frozenset({3})))
    assert page.result is not None
    assert isinstance(page.result.content, RollZeroResult)
    assert page.result.content.fit is not None
    assert page.result.content.fit["zero_rad"] == pytest.approx(ZERO_RAD, abs=math.radians(1.0))
    for told in (
        "Needle N1 bends towards −y",
        "fitted cosine",
        "roll zero, ± 2 SD",
        "1 picture did not show",
    ):
        assert told in page.html
    assert page.html.count("data:image/jpeg") == 6
    for roll_deg in (0, 60, 120, 240, 300):
        assert f'<td class="n">{roll_deg}.0</td>' in page.html
    residuals = re.findall(r'<td class="n">([+−]0\.\d{3})</td></tr>', page.html)
    assert len(residuals) == 5
    total = math.fsum(float(residual.replace("−", "-")) for residual in residuals)
    assert total == pytest.approx(0.0, abs=0.005)
