"""The page of a roll zero run: the cosine of the roll, each insertion, and its picture."""

import math
import re

import pytest

from labrig.experiments.roll_zero.result import RollZeroResult
from tests.analysis.synthetic import record_roll_zero
from tests.report.conftest import WrittenPage, make_page

ZERO_RAD = math.radians(20.0)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> WrittenPage:
    """The page of a needle that bends towards −y at 20 degrees; the fourth picture shows no needle."""
    return make_page(record_roll_zero(tmp_path_factory.mktemp("roll"), ZERO_RAD, frozenset({3})))


def test_the_zero_and_its_cosine_are_drawn(page: WrittenPage) -> None:
    """The page states the zero and draws it with its cosine."""
    assert page.result is not None
    assert isinstance(page.result.content, RollZeroResult)
    assert page.result.content.fit is not None
    assert page.result.content.fit["zero_rad"] == pytest.approx(ZERO_RAD, abs=math.radians(1.0))
    assert "Needle N1 bends towards −y" in page.html
    assert "fitted cosine" in page.html
    assert "roll zero, ± 2 SD" in page.html


def test_each_insertion_has_its_line_and_its_picture(page: WrittenPage) -> None:
    """Each insertion has a row with roll, deflection and residual, and a picture, even if it was refused."""
    assert page.result is not None
    assert isinstance(page.result.content, RollZeroResult)
    assert page.html.count("data:image/jpeg") == 6
    assert "1 picture did not show" in page.html
    for roll_deg in (0, 60, 120, 240, 300):
        assert f'<td class="n">{roll_deg}.0</td>' in page.html
    residuals = re.findall(r'<td class="n">([+−]0\.\d{3})</td></tr>', page.html)
    assert len(residuals) == 5
    total = math.fsum(float(residual.replace("−", "-")) for residual in residuals)
    assert total == pytest.approx(0.0, abs=0.005)
