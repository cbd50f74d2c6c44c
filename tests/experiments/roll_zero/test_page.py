"""The page of a roll zero run: the cosine of the roll, each insertion, and its picture."""

import math
import re
from pathlib import Path

import pytest

from labrig.analysis.result import AnalysisResult
from labrig.experiments.registry import load_run_protocol
from labrig.experiments.roll_zero.page import make_page as roll_zero_page
from labrig.experiments.roll_zero.protocol import RollZeroProtocol
from labrig.experiments.roll_zero.result import RollZeroResult
from tests.analysis.synthetic import record_roll_zero
from tests.report.conftest import WrittenPage, make_page

ZERO_RAD = math.radians(20.0)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> WrittenPage:
    """The page of a needle that bends towards -y at 20 degrees; the fourth picture shows no needle."""
    return make_page(record_roll_zero(tmp_path_factory.mktemp("roll"), ZERO_RAD, frozenset({3})))


def test_the_zero_and_its_cosine_are_drawn(page: WrittenPage) -> None:
    """The page states the zero and draws it with its cosine."""
    assert page.result is not None
    assert isinstance(page.result.content, RollZeroResult)
    assert page.result.content.fit is not None
    assert page.result.content.fit["zero_rad"] == pytest.approx(ZERO_RAD, abs=math.radians(1.0))
    assert "Needle N1 bends towards -y" in page.html
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


def test_a_result_of_an_earlier_labrig_has_its_page(tmp_path: Path) -> None:
    """A result without the constant of the fit has its deflections drawn, without a curve."""
    run = record_roll_zero(tmp_path, 0.0)
    first = make_page(run)
    assert first.result is not None
    shown = first.result.content.model_copy(update={"offset_mm": None})
    assert isinstance(shown, RollZeroResult)
    protocol = load_run_protocol(first.run)
    assert isinstance(protocol, RollZeroProtocol)
    page = roll_zero_page(first.run, protocol, AnalysisResult(first.result.path, shown))
    assert "fitted cosine" not in page.shown["figure"]
